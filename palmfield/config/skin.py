"""Keys of palmfield.skin."""

from importlib.metadata import entry_points
from typing import Annotated, ClassVar, Literal, Self, get_args

from pydantic import AfterValidator, Field, model_validator

from palmfield.config.base import Amounts, Config, Names, NonNegative, Positive, Shares

Length = Annotated[float, Field(ge=5e-4, le=1.0)]
ArpLaw = Literal["default", "alpha"]
Base = Literal["bonded", "free_slip", "free", "springs", "deep", "muscle"]
ENDLESS = ("deep", "muscle")
"""Values of key `base` for tissue that continues downwards without limit."""
Side = Literal["fixed", "free", "roller", "absorbing"]
SPRINGS = ("base_normal_Pa_m", "base_tangential_Pa_m", "base_normal_Pa_s_m", "base_tangential_Pa_s_m")
WHOLE_HISTORY = ("axisymmetric", "lateral_waves")
"""Solvers that need the whole load history in advance. A scene cannot use them."""
Solver = Literal["auto", "wedges", "reduced", "modal", "spectral_elements", "particles"]
NOT_LINEAR = ("particles",)
"""Solvers for which the response to two loads is not the sum of the two responses."""
SKIN_SOLVERS = "palmfield.skin_solvers"
"""Entry points of other packages: name of a solver -> maker of a `palmfield.skin.explicit_layer.ExplicitLayer`."""
OVERRIDES = ("density_kg_m3", "shear_relaxed_Pa", "shear_branch_Pa", "relaxation_time_s", "bulk_Pa")


def _installed(solver: str) -> str:
    """Return the name of a solver of another package. Raises ValueError if it is not installed."""
    if not entry_points(group=SKIN_SOLVERS, name=solver):
        raise ValueError(solver)
    return solver


Shape = Literal["hand", "articulated", "disc", "mesh", "rigged", "cylinder"]
BODIES = tuple(shape for shape in get_args(Shape) if shape != "disc")
"""Shapes that carry a skin layer. A disc is not in this list, because it is itself the layer."""
OF_SHAPES = {
    "hand": ("hand", "articulated"),
    "mesh": ("mesh", "rigged"),
    "mesh_unit": ("mesh", "rigged"),
    "cylinder_radius_m": ("cylinder",),
    "cylinder_length_m": ("cylinder",),
    "radius_m": ("disc",),
    "thickness_m": ("disc",),
    "patch_site": BODIES,
    "patch_radius_m": BODIES,
    "cover": BODIES[:4],
    "depth_m": BODIES,
    "force_accuracy": BODIES,
}
"""Keys that apply only to some shapes. With another shape they raise an error."""
THICKEST = 0.85
"""Largest ratio of layer thickness to cylinder radius. In thicker layers, the elements near the axis are too thin."""
WITH_A_UNIT = (".glb", ".gltf", ".pkl")
"""Mesh file formats that define the unit of length."""


class SkinConfig(Config):
    plugin: ClassVar[str] = "palmfield.skin"
    about: ClassVar[str] = "The surface of the body in the sound, and the viscoelastic skin layer on part of it."
    files: ClassVar[tuple[str, ...]] = ("mesh",)
    renamed: ClassVar[dict[str, str]] = {"solver=full": "wedges", "solver=implicit": "wedges"}
    refused: ClassVar[dict[str, str]] = {
        f"solver={name}": (
            "which needs the whole load history in advance, and a scene has none: call palmfield.skin.solve(..., "
            f"solver='{name}'), or set solver to auto"
        )
        for name in WHOLE_HISTORY
    }

    body: str = Field("hand", description="body that carries the surface; its frame is the frame of the surface")
    shape: Shape = Field(
        "hand",
        description="parametric hand, rigid (hand) or on its bones (articulated); flat disc; mesh file, rigid "
        "(mesh) or on its joints (rigged); cylinder with a rigid bone inside a layer of depth_m",
    )
    hand: str = Field(
        "open_men_p50", description="shapes hand and articulated: a preset in hand_models/ or the path of a .toml file"
    )
    mesh: str | None = Field(
        None, description="shape mesh: an OBJ, PLY, STL, glTF, GLB or MANO .pkl file; shape rigged: glTF, GLB or MANO"
    )
    mesh_unit: Literal["m", "dm", "cm", "mm", "in", "auto"] | None = Field(
        None,
        description="shapes mesh, rigged: length unit of the file; auto: metres for glTF and MANO, which need no key, "
        "otherwise the unit that gives the size of a hand",
    )
    cylinder_radius_m: Length | None = Field(
        None, description="shape cylinder: outer radius; its axis is the x axis of the body, its centre the origin"
    )
    cylinder_length_m: Length | None = Field(None, description="shape cylinder: length")
    radius_m: Length | None = Field(None, description="shape disc: radius; the loaded face is z = 0 with normal +z")
    thickness_m: Length | None = Field(None, description="shape disc: thickness")
    patch_site: str | None = Field(
        None,
        description="site on the body, in the reference pose, at the centre of the skin layer (all shapes except disc)",
    )
    patch_radius_m: Length | None = Field(
        None, description="radius of the skin layer (default: chosen by the plan; all shapes except disc)"
    )
    cover: Literal["patch", "palmar", "whole"] = Field(
        "patch",
        description="extent of the layer: around patch_site; palm and palmar side of the fingers; all skin of a hand",
    )
    depth_m: Length = Field(
        0.02,
        description="largest depth of the layer (all shapes except disc); on a hand, the depth to the bone if that is "
        "smaller",
    )
    material: str = Field("palm", description="a preset, by name (materials.md)")
    materials: Names = Field(
        (), description="presets of several sheets from the surface down, in place of `material`; needs `shares`"
    )
    shares: Shares = Field(
        (), description="thickness of each sheet as a share of the layer thickness; the shares add up to 1"
    )
    density_kg_m3: Positive | None = Field(None, description="overrides the preset")
    shear_relaxed_Pa: Positive | None = Field(None, description="overrides the preset: long-time shear modulus")
    shear_branch_Pa: NonNegative | None = Field(None, description="overrides the preset: modulus of the Maxwell branch")
    relaxation_time_s: Positive | None = Field(
        None, description="overrides the preset: relaxation time of the Maxwell branch"
    )
    bulk_Pa: Positive | None = Field(None, description="overrides the preset: bulk modulus")
    base: Base = Field(
        "bonded",
        description="inner face of the layer: bonded to bone, or sliding on it; free; springs, with base_normal and "
        "base_tangential; deep: the deepest material goes on without end; muscle: muscle does. Use deep and "
        "muscle with side absorbing",
    )
    base_normal_Pa_m: Positive | None = Field(None, description="base springs: normal stiffness per area")
    base_tangential_Pa_m: Positive | None = Field(None, description="base springs: tangential stiffness per area")
    base_normal_Pa_s_m: NonNegative | None = Field(None, description="base springs: normal damping per area")
    base_tangential_Pa_s_m: NonNegative | None = Field(None, description="base springs: tangential damping per area")
    foundation_normal_Pa_m: Positive | None = Field(
        None, description="normal stiffness per area of the tissue below the layer, in place of a bonded base"
    )
    foundation_tangential_Pa_m: Positive | None = Field(
        None,
        description="tangential stiffness per area of the tissue below the layer; it relaxes like the deepest material",
    )
    side: Side = Field(
        "fixed",
        description="boundary condition at the cut faces of the layer; absorbing transmits waves; roller for "
        "discs only",
    )
    arp_law: ArpLaw = Field("default", description="radiation-pressure law (see `palmfield info`)")
    arp_alpha: Annotated[float, Field(ge=1, le=2)] | None = Field(
        None,
        description="arp_law alpha: ARP divided by p_rms^2/(rho c^2); equals 1 + R for skin with energy reflectance R "
        "(default 2); arp_peak_Pa of a stimulus is |p|^2/(rho c^2) for any alpha",
    )
    body_sound: Literal["none", "shadows", "scattering"] = Field(
        "none",
        description="effect of other parts of the body on the sound: none, shadows, or scattering by boundary elements",
    )
    shadow_edges: Literal["knife_edge", "rays"] = Field(
        "knife_edge",
        description="body_sound shadows: knife_edge diffracts the sound of each transducer at edges (Fresnel "
        "weight); rays makes each point fully lit or dark",
    )
    accuracy: Annotated[float, Field(ge=0.002, le=0.5)] = Field(
        0.05, description="target accuracy: relative error of the skin displacement"
    )
    force_accuracy: Annotated[float, Field(ge=0.0015, le=0.05)] = Field(
        0.006,
        description="target relative error of the acoustic force and torque on the body, rms over foci on its lit "
        "side; not for a disc. Samples: four per face below 0.004, one per face from 0.004 on, 3.6 times "
        "fewer from 0.006 on, 7 times fewer from 0.012 on",
    )
    max_frequency_Hz: Annotated[float, Field(gt=0, le=2000)] | None = Field(
        None, description="highest frequency to resolve (default: from the stimulus)"
    )
    solver: Solver | Annotated[str, AfterValidator(_installed)] = Field(
        "auto",
        description="wedges: full model of the layer; reduced: reduced model for this stimulus; modal: modes for every "
        "stimulus and pose; auto: the fastest of these; spectral_elements: explicit, for a GPU; particles: a "
        "preview with a stated error",
    )
    inertia: Literal["off", "on"] = Field(
        "off",
        description="on: recorded runs also have the motion of the layer by the acceleration of its bones (skin.md)",
    )
    obstacles: Names = Field(
        (),
        description="body_sound shadows: further bodies that cast shadows, with their geoms and those of their child "
        "bodies",
    )
    receptors: Literal["off", "on"] = Field(
        "off", description="on: record the motion at afferents (SA1, RA1, PC) and compute their levels and spikes"
    )
    receptor_densities_per_cm2: Amounts = Field(
        (), description="receptors on: SA1, RA1 and PC afferents per cm2 (default: by region of the hand, receptors.md)"
    )
    receptor_depths_m: Amounts = Field(
        (), description="receptors on: depths of the endings of SA1, RA1 and PC (default: 0.0007 0.0007 0.002)"
    )
    receptor_seed: Annotated[int, Field(ge=0)] = Field(
        0, description="receptors on: number of the draw of the places of afferents"
    )
    focus_region_m: Annotated[float, Field(ge=0, le=0.5)] = Field(
        0.02,
        description="radius of the region in which elements are fine enough for a focus: all foci in it share one "
        "mesh; 0: only around the focus or path of the stimulus",
    )
    element_m: Positive | None = Field(None, description="fixes the element edge length at the focus")
    step_s: Positive | None = Field(
        None, description="fixes the time step of the skin; must divide the timestep of the scene"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.shape == "disc" and (self.radius_m is None or self.thickness_m is None):
            raise ValueError("shape 'disc' needs radius_m and thickness_m")
        self._check_cylinder()
        self._check_surface()
        if self.shape != "disc" and self.patch_site is None:
            raise ValueError(f"shape '{self.shape}' needs patch_site")
        if (self.foundation_normal_Pa_m is None) != (self.foundation_tangential_Pa_m is None):
            raise ValueError("foundation_normal_Pa_m and foundation_tangential_Pa_m must be given together; give both")
        if self.foundation is not None and self.base != "bonded":
            raise ValueError(
                f"foundation_normal_Pa_m replaces a bonded base, but base is '{self.base}': remove one of the two keys"
            )
        if self.base == "free" and self.side != "fixed":
            raise ValueError(f"base 'free' with side '{self.side}' leaves the layer without support: fix one of them")
        springs = [key for key in SPRINGS if getattr(self, key) is not None]
        if self.base == "springs" and not set(SPRINGS[:2]) <= set(springs):
            raise ValueError("base 'springs' needs base_normal_Pa_m and base_tangential_Pa_m")
        if self.base != "springs" and springs:
            raise ValueError(
                f"{springs[0]} applies to base 'springs', but base is '{self.base}': remove the key, or set base"
            )
        if self.base in ENDLESS and self.shape == "cylinder":
            raise ValueError(f"base '{self.base}' is tissue without end, but shape 'cylinder' has a bone: use bonded")
        self._check_sheets()
        self._check_receptors()
        if self.inertia == "on" and self.solver in NOT_LINEAR:
            raise ValueError(
                f"inertia 'on' adds two motions, but solver '{self.solver}' is not linear: set another solver"
            )
        if self.inertia == "on" and self.base in ENDLESS:
            raise ValueError(f"inertia 'on' needs bone below the layer, but base is '{self.base}': set base to bonded")
        if self.obstacles and self.body_sound != "shadows":
            raise ValueError(
                f"obstacles need body_sound 'shadows', but body_sound is '{self.body_sound}': set it to shadows"
            )
        if "shadow_edges" in self.model_fields_set and self.body_sound != "shadows":
            raise ValueError(
                f"shadow_edges '{self.shadow_edges}' applies to body_sound 'shadows', but body_sound is "
                f"'{self.body_sound}': remove the key, or set body_sound to shadows"
            )
        if self.arp_alpha is not None and self.arp_law != "alpha":
            raise ValueError(
                f"arp_alpha {self.arp_alpha:g} applies to arp_law 'alpha', but arp_law is '{self.arp_law}': remove "
                "the key, or set arp_law to alpha"
            )
        if self.side == "roller" and self.shape != "disc":
            raise ValueError("side 'roller' needs the symmetry of shape 'disc'; use fixed or free")
        return self

    def _check_cylinder(self) -> None:
        if self.shape != "cylinder":
            return
        if self.cylinder_radius_m is None or self.cylinder_length_m is None:
            raise ValueError("shape 'cylinder' needs cylinder_radius_m and cylinder_length_m")
        if self.depth_m > THICKEST * self.cylinder_radius_m:
            raise ValueError(
                f"depth_m {self.depth_m:g} leaves no room for bone in a cylinder with cylinder_radius_m "
                f"{self.cylinder_radius_m:g}; allowed: at most {THICKEST * self.cylinder_radius_m:.4g}"
            )

    def _check_surface(self) -> None:
        for key, shapes in OF_SHAPES.items():
            if key in self.model_fields_set and getattr(self, key) is not None and self.shape not in shapes:
                allowed = " or ".join(f"'{shape}'" for shape in shapes)
                raise ValueError(
                    f"{key} applies to shape {allowed}, but shape is '{self.shape}': remove the key, or set shape"
                )
        if self.shape not in OF_SHAPES["mesh"]:
            return
        if self.mesh is None:
            raise ValueError(f"shape '{self.shape}' needs mesh")
        if self.mesh_unit is None and not self.mesh.lower().endswith(WITH_A_UNIT):
            raise ValueError(
                f"shape '{self.shape}' needs mesh_unit for '{self.mesh}': only {', '.join(WITH_A_UNIT)} files "
                "define their unit"
            )

    def _check_sheets(self) -> None:
        if len(self.materials) != len(self.shares):
            raise ValueError(
                f"materials has {len(self.materials)} names, but shares has {len(self.shares)} numbers: give one "
                "share for each material"
            )
        if self.shares and abs(sum(self.shares) - 1.0) > 1e-6:
            raise ValueError(f"shares add up to {sum(self.shares):g}; required: 1")
        own = [key for key in ("material", *OVERRIDES) if key in self.model_fields_set]
        if self.materials and own:
            raise ValueError(
                f"materials sets the preset of every sheet, and {own[0]} that of a single one: remove one of the two"
            )

    def _check_receptors(self) -> None:
        given = sorted(key for key in self.model_fields_set if key.startswith("receptor_"))
        if given and self.receptors == "off":
            raise ValueError(f"{given[0]} applies to receptors 'on', but receptors is 'off': remove the key, or set on")
        for key in ("receptor_densities_per_cm2", "receptor_depths_m"):
            if len(getattr(self, key)) not in (0, 3):
                raise ValueError(f"{key} has {len(getattr(self, key))} numbers; give three: SA1, RA1 and PC")
        if self.receptors == "on" and not (self.receptor_densities_per_cm2 or self.shape in OF_SHAPES["hand"]):
            raise ValueError(
                f"receptors has value 'on', but densities of afferents on shape '{self.shape}' are unknown; give "
                "receptor_densities_per_cm2, three numbers, or set receptors off"
            )
        if self.receptor_densities_per_cm2 and not any(self.receptor_densities_per_cm2):
            raise ValueError("receptor_densities_per_cm2 is 0 for all classes; give one above 0, or set receptors off")

    @property
    def unit(self) -> str:
        """Length unit of the file of key `mesh`, or "auto" if no key sets it."""
        return self.mesh_unit or "auto"

    @property
    def springs(self) -> tuple[float, float, float, float] | None:
        """Stiffness [Pa/m] and damping [Pa s/m] per area of base `springs`, normal and tangential; else None."""
        if self.base != "springs":
            return None
        normal, tangential, normal_loss, tangential_loss = (getattr(self, key) or 0.0 for key in SPRINGS)
        return normal, tangential, normal_loss, tangential_loss

    @property
    def foundation(self) -> tuple[float, float] | None:
        """Normal and tangential stiffness per area of the tissue below the layer [Pa/m], or None."""
        if self.foundation_normal_Pa_m is None or self.foundation_tangential_Pa_m is None:
            return None
        return self.foundation_normal_Pa_m, self.foundation_tangential_Pa_m
