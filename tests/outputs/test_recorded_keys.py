"""Keys that a result holds are read back as they were, with what files and surfaces added to them."""

import pytest
import xarray as xr

from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import OutputError
from palmfield.outputs.recorded_keys import keys_of
from palmfield.stimulus.resolved_keys import ResolvedStimulus


@pytest.mark.parametrize("added", [{}, {"sites_length_m": 0.12}, {"duty_exponent": 1.5}])
def test_keys_go_there_and_back(added):
    keys = {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 70.0}
    written = ResolvedStimulus(**keys, **added) if added else StimulusConfig(**keys)
    group = xr.Dataset(attrs={"config": written.model_dump_json()})
    back = keys_of(ResolvedStimulus, "stimulus", group)
    assert back.model_dump(exclude=set(ResolvedStimulus.model_fields) - set(written.model_fields_set)) == (
        written.model_dump(include=written.model_fields_set)
    )


def test_a_group_without_keys_is_refused():
    with pytest.raises(OutputError, match=r"instance 'stimulus' of the result: the stored keys of plugin 'palmfield"):
        keys_of(ResolvedStimulus, "stimulus", xr.Dataset())
