"""Scene -> frames."""

from __future__ import annotations

from dataclasses import replace

from forestgen.core.parts import Part
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.core.timing import Timings
from forestgen.recipe.schema import Recipe
from forestgen.render.denoise import denoise
from forestgen.render.frame import Frame
from forestgen.render.identity import trace_identity
from forestgen.render.radiance import render_radiance
from forestgen.scene.spec import Camera, SceneSpec


def render_frame(
    spec: SceneSpec, camera: Camera, recipe: Recipe, seed: int, progress: Progress, timings: Timings
) -> Frame:
    """Identity first (it tells where the sky is and guides the denoiser), then radiance, then the denoised copy."""
    with progress.stage(f"identity {camera.name}", camera.size_px[1]) as advance:
        identity = trace_identity(spec, camera, samples=recipe.labels.samples, timer=timings, advance=advance)
    from scipy.ndimage import binary_dilation

    # A sliver of sky may lie between samples: neighbours of pixels that see the sky may see it too.
    may_see_sky = binary_dilation((identity.part == Part.NOTHING).any(axis=2), iterations=2)
    radiance = render_radiance(
        spec,
        camera,
        samples=recipe.render.samples,
        max_depth=recipe.render.max_depth,
        seed=child_seed(seed, "radiance", camera.name),
        progress=progress,
        sky_share=may_see_sky,
        timer=timings,
    )
    if recipe.render.denoise:
        with timings("denoise"):
            clean = denoise(radiance.mean, identity.albedo, identity.mean_normal)
        radiance = replace(radiance, denoised=clean)
    return Frame(camera=camera, radiance=radiance, identity=identity)
