"""A colour chart as the renderer sees it: at 81 wavelengths, and as images in both of its modes.

Sun and sky are rendered apart and added. The image of the spectral mode is made of eight replicates with the nodes and
weights of any image's (render/wavelengths.py). Their places in the strata follow each other by the golden ratio, which
all but removes the noise of the choice of wavelengths: what remains is the mode's own error and the noise of paths.
The image of the colour mode is one pass in linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng, child_seed
from forestgen.render.build import origin_of
from forestgen.render.capture import capture
from forestgen.render.irradiance import Floats, Lit, Source, passes_at, sources_of
from forestgen.render.variant import BLOCK_PX, SCALAR, using
from forestgen.render.wavelengths import ColourBySpectrum
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.spec import Camera, SceneSpec

WAVELENGTHS_NM = np.arange(380.0, 781.0, 5.0)  # the colour matching functions' own table has steps of 5 nm (CIE 15)

_REPLICATES = 8  # of the spectral mode


@dataclass(frozen=True, eq=False)
class ChartImages:
    """What a camera sees."""

    wavelengths: NDArray[np.float32]  # (H, W, 81) W/m²/sr/nm
    spectral: NDArray[np.float32]  # (H, W, 3) of the spectral mode, linear Rec. 709 in cd/m²
    rgb: NDArray[np.float32]  # (H, W, 3) of the colour mode, likewise


def render_chart(
    spec: SceneSpec,
    camera: Camera,
    *,
    samples: int,
    max_depth: int,
    seed: int,
    progress: Progress,
    sources: Callable[[Floats], Sequence[Source]] | None = None,
) -> ChartImages:
    """Render `camera`'s view.

    Parameters
    ----------
    samples : of each pixel by each light in each mode's image; a quarter of them at each of the 81 wavelengths.
    sources : lights in place of the scene's own, by the origin of the renderer's frame.
    """
    origin = origin_of(camera)
    with using(SCALAR):
        lights = sources(origin) if sources is not None else sources_of(spec, origin)
        lit = Lit(spec, origin, lights)
        integrators = [lit.integrator(row, max_depth=max_depth, block_px=BLOCK_PX) for row in range(len(lights))]
        threes, passes = passes_at(WAVELENGTHS_NM), ColourBySpectrum().passes
        fewer = max(1, samples // 4)

        def view(channels: Channels, count: int, name: str, *number: int) -> Floats:
            lit.show(channels)
            images = [
                capture(integrator, scene, camera, samples=count, seed=child_seed(seed, name, source.name, *number))
                for integrator, scene, source in zip(integrators, lit.scenes, lights, strict=True)
            ]
            advance(1)
            return np.asarray(np.sum(images, axis=0)[..., :3])

        with progress.stage("chart", 1 + _REPLICATES * passes + len(threes)) as advance:
            rgb = view(RGB, samples, "rgb")
            spectral = np.zeros_like(rgb)
            for replicate in range(_REPLICATES):
                for index, one in enumerate(ColourBySpectrum().draw(child_rng(seed, "wavelengths"), replicate)):
                    few = max(1, round(samples / _REPLICATES / passes))
                    spectral += view(one.channels, few, "spectral", replicate, index) @ one.weight.T / _REPLICATES
            wavelengths = np.empty((*rgb.shape[:2], len(WAVELENGTHS_NM)), dtype=np.float32)
            for rows, channels in threes:
                # All wavelengths follow the same random numbers: noise does not bend spectra.
                wavelengths[..., rows] = view(channels, fewer, "wavelengths")
    return ChartImages(wavelengths, spectral.astype(np.float32), rgb.astype(np.float32))
