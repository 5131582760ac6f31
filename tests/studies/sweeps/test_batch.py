"""How points are cut into batches and shared out among workers."""

from collections import defaultdict

import pytest

from palmfield.studies.sweeps.batch import BATCHES_PER_WORKER, MOST_IN_BATCH, batches


def cut(groups, workers):
    """Batches of a design whose points 0, 1, 2, ... belong to groups."""
    return batches(range(len(groups)), dict(enumerate(groups)), workers)


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("groups", ["a", "aab", "a" * 100, "abcd" * 25, "a" * 60 + "bcdefg" * 3], ids=len)
def test_each_point_is_in_one_batch_of_its_group(groups, workers):
    found = cut(groups, workers)
    assert sorted(point for batch in found for point in batch.points) == list(range(len(groups)))
    for batch in found:
        assert len({groups[point] for point in batch.points}) == 1
        assert 0 < len(batch.points) <= MOST_IN_BATCH and 0 <= batch.worker < workers


def test_one_group_is_shared_out_evenly():
    found = cut("a" * 1000, 2)
    shares = [sum(len(batch.points) for batch in found if batch.worker == worker) for worker in (0, 1)]
    assert shares == [500, 500]
    # The workers begin at the same time
    assert [batch.worker for batch in found[:4]] == [0, 1, 0, 1]


def test_a_model_is_made_by_one_worker_where_there_are_many():
    groups = "abcdefgh" * 12
    found = cut(groups, 2)
    makers = defaultdict(set)
    for batch in found:
        makers[groups[batch.points[0]]].add(batch.worker)
    assert all(len(workers) == 1 for workers in makers.values())
    assert {worker for workers in makers.values() for worker in workers} == {0, 1}


def test_few_points_are_cut_so_that_all_workers_have_some():
    assert len(cut("a" * 8, 2)) == 2 * BATCHES_PER_WORKER
    assert cut("", 3) == []
