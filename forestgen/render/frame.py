"""The contracts of rendering: what to render and until when, and what one camera saw. Imports no renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Band
from forestgen.render.wavelengths import Mode
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Camera, SceneSpec

CloudTransport = Literal["farfield", "exact"]
Timer = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True)
class StoppingCriterion:
    """When an image is done. Samples are light paths a pixel, over all passes."""

    samples: int  # exactly; with a target or a time budget the first ones, from which the noise is judged
    target_error: float | None = None  # relative error
    target_error_p95: float | None = None  # its 95th percentile
    time_budget_s: float | None = None
    most_samples: int = 65536  # with a target or a time budget

    @property
    def open_ended(self) -> bool:
        return not (self.target_error is None and self.target_error_p95 is None and self.time_budget_s is None)


@dataclass(frozen=True)
class RenderJob:
    """What to render, and how well."""

    spec: SceneSpec
    camera: Camera
    until: StoppingCriterion
    seed: int  # of the frame
    mode: Mode = "rgb"  # a camera with bands is rendered at wavelengths whatever it says
    max_depth: int = 64  # longest path through the canopy; clouds have their own
    cloud_transport: CloudTransport = "farfield"
    position_m: NDArray[np.float32] | None = None  # (H, W, 3) world, of what pixels show, NaN sky; None: near the site

    @property
    def is_exact(self) -> bool:
        """Whether light is traced through the clouds' volume and the scene together."""
        return self.spec.clouds is not None and self.cloud_transport == "exact"


class View(Protocol):
    """A scene, ready to be captured."""

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) radiance in three channels, by independent paths for each `number` of replicate and pass."""


@dataclass(frozen=True)
class Identity:
    """What each sample of the identity pass hit, traced on the radiance pass' own geometry."""

    plant_id: NDArray[np.uint32]  # (H, W, S); 0 where no plant is hit
    part: NDArray[np.uint8]  # (H, W, S) forestgen.core.parts.Part; NOTHING is sky
    exemplar: NDArray[np.uint32] | None = None  # (H, W, S) index into SceneSpec.exemplars + 1; 0 for ground and sky
    face: NDArray[np.uint32] | None = None  # (H, W, S) triangle of the exemplar, as in `Surface`


@dataclass(frozen=True)
class Surface:
    """What the ray through each pixel's centre meets first; the sky where it meets nothing."""

    plant_id: NDArray[np.uint32]  # (H, W); 0 for ground and sky. Not always the mask's plant, which wins by coverage
    part: NDArray[np.uint8]  # (H, W) forestgen.core.parts.Part; NOTHING is sky
    exemplar: NDArray[np.uint32]  # (H, W) index into SceneSpec.exemplars + 1; 0 for ground and sky
    face: NDArray[np.uint32]  # (H, W) triangle of the exemplar, its organs one after another, or of the ground; sky 0
    depth_m: NDArray[np.float32]  # (H, W) along the camera's z; inf for the sky
    distance_m: NDArray[np.float32]  # (H, W) along the ray; inf for the sky
    position_m: NDArray[np.float32]  # (H, W, 3) world; NaN for the sky
    normal: NDArray[np.float32]  # (H, W, 3) world, unit, geometric, towards the camera; 0 for the sky
    shading_normal: NDArray[np.float32]  # (H, W, 3) world, unit, interpolated, on the geometric one's side; sky 0
    albedo: NDArray[np.float32]  # (H, W, 3) reflectance + transmittance there, textures included; sky 0
    sun_visible: NDArray[np.bool_]  # (H, W) nothing of the scene hides the sun's centre, by night the moon's; sky False


@dataclass(frozen=True)
class Amodal:
    """Plants seen alone, nothing in front of them: one row a plant that was asked for, by rising plant_id."""

    plant_id: NDArray[np.uint32]  # (M,)
    samples: int  # a pixel, at the identity pass' own sub-pixel positions
    window_px: NDArray[np.int32]  # (M, 4) x, y, width, height: the part of the image that holds all of its samples
    first: NDArray[np.int64]  # (M + 1,) where each window's counts begin, row by row
    hits: NDArray[np.uint16]  # (first[M],) samples of the pixel that hit the plant alone
    full_box_px: NDArray[np.float64]  # (M, 4) left, top, right, bottom of the projected plant, to 16 image sizes away


@dataclass(frozen=True)
class Branches:
    """The branch module and its segment that the ray through each pixel's centre meets: labels/channels/surface.py."""

    module: NDArray[np.uint32]  # (H, W) number of the module + 1; 0 where no plant of branch modules is hit
    node: NDArray[np.uint32]  # (H, W) of the module's prototype that ends the segment; 0 is the plant's foot, or none
    is_own: NDArray[np.bool_]  # (H, W) the module is the plant's own, not that of the plant that stands for it


@dataclass(frozen=True)
class SunAtLens:
    """The sun, or by night the moon, as it shines on a camera's lens."""

    direction: tuple[float, float, float]  # unit, camera's axes
    irradiance: tuple[float, ...]  # by channel, of a surface that faces it; what stands in the way is taken off


@dataclass(frozen=True)
class Radiance:
    """What the sensor measured, by channel: linear Rec. 709 in cd/m², or bands in W/m²/sr/nm."""

    mean: NDArray[np.float32]  # (H, W, C)
    variance: NDArray[np.float32]  # (H, W, C) of the mean
    denoised: NDArray[np.float32] | None  # (H, W, C) biased
    samples: int
    channels: tuple[str, ...] = ("R", "G", "B")
    bands: tuple[Band, ...] = ()  # of the channels; none: linear Rec. 709
    replicates: int = 0  # independent estimates behind each variance
    open_irradiance: tuple[float, ...] = ()  # of level ground in the open, clouds left out, by channel: lux, or W/m²/nm
    relative_error: float = float("nan")  # standard error over value, mean of the pixels: render/rendering.py
    relative_error_p95: float = float("nan")  # its 95th percentile
    sun: SunAtLens | None = None  # for the ghosts of a lens; None: it has none, or sees no sun
    stopped_by: str = "samples"  # why no more: "target_error", "most_samples" or "time_budget_s" where one was set


@dataclass(frozen=True)
class Frame:
    """One camera's view of one drawn recipe."""

    camera: Camera
    radiance: Radiance
    identity: Identity
    surface: Surface
    amodal: Amodal | None = None  # of the plants that the identity pass saw
    cloud_opacity: NDArray[np.float32] | None = None  # (H, W) in [0, 1]: 1 - transmittance along the centre's ray
    branches: Branches | None = None  # branch modules, see labels/channels/surface.py
    motion_px: NDArray[np.float32] | None = None  # (H, W, 2) right, down, to the sequence's next frame; NaN: unknown
    own: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # (H, W) or (H, W, C) of other packages' channels
