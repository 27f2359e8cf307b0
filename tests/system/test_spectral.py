"""Images at wavelengths: against Mitsuba's own spectral renderer, against integrals, and against colour."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shots import identity, radiance

from forestgen.community.simulation import final_population
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Band, Spectrum
from forestgen.recipe.load import load_recipe
from forestgen.render import wavelengths
from forestgen.render.capture import capture
from forestgen.render.denoise import denoise, denoise_bands
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.identity import SceneTracer
from forestgen.render.rendering import _replicate
from forestgen.render.variant import SCALAR, mitsuba, using
from forestgen.render.views import build_view
from forestgen.render.wavelengths import BandsBySpectrum, ColourAtOnce, ColourBySpectrum, quadrature_of
from forestgen.scene.build import build_scene
from forestgen.scene.colour import Channels, colour_of_radiance, colour_of_reflectance, colour_science, observer
from forestgen.scene.plan import make_plan
from forestgen.scene.spec import Camera, Material, SceneSpec, Sky
from support.guides import trace_guides
from support.scenes import camera_at, plain_ground, scattered_scene
from support.tiers import few

VISIBLE = np.arange(360.0, 831.0, 5.0)


def box(low, high, name="box") -> Band:
    return Band(
        name, Spectrum(np.array([low - 0.5, low + 0.5, high - 0.5, high + 0.5]), np.array([0.0, 1.0, 1.0, 0.0]))
    )


def bell(middle, width, name="bell") -> Band:
    wavelength = np.linspace(middle - 3 * width, middle + 3 * width, 61)
    return Band(name, Spectrum(wavelength, np.exp(-0.5 * ((wavelength - middle) / width) ** 2)))


def smooth(middle, width, low=0.05, high=0.7) -> Spectrum:
    """A reflectance that rises at a wavelength, as soil, or (negative width) falls."""
    return Spectrum(VISIBLE, low + (high - low) / (1 + np.exp(-(VISIBLE - middle) / width)))


def leafy(scale=1.0) -> Spectrum:
    """Green in the middle, dark beside it, bright from the red edge on."""
    green = 0.09 * np.exp(-0.5 * ((VISIBLE - 550) / 28) ** 2)
    return Spectrum(VISIBLE, scale * (0.04 + green + 0.42 / (1 + np.exp(-(VISIBLE - 716) / 9))))


# Light of 2856 K by Planck's law, in arbitrary units: nearly CIE A.
WARM = Spectrum(
    VISIBLE, 40 * (VISIBLE / 560) ** -5 / np.expm1(1.4388e7 / (VISIBLE * 2856)) * np.expm1(1.4388e7 / (560 * 2856))
)


@pytest.mark.parametrize("spectrum", [WARM, leafy(), smooth(600, 8), Spectrum(VISIBLE, np.ones_like(VISIBLE))])
def test_nodes_give_the_integral_on_average(spectrum):
    """Unbiased, whatever the spectrum; and a replicate of colour is off by a few percent at most."""
    bands = (box(480, 510), bell(555, 30), bell(600, 35), box(700, 702), bell(650, 4))
    for quadrature, truth, scatter in (
        (ColourBySpectrum(), colour_of_radiance(spectrum), 0.04),
        (BandsBySpectrum(bands), np.array([band.mean(spectrum) for band in bands]), 0.5),
    ):
        drawn = []
        for number in range(300):
            passes = quadrature.draw(child_rng(number, "wavelengths"), number)
            assert len(passes) == quadrature.passes
            drawn.append(sum(one.weight @ one.channels.of_light(spectrum) for one in passes))
        scale = np.abs(truth).max() if len(truth) == 3 else np.abs(truth)
        error = (np.array(drawn) - truth) / scale
        standard = error.std(axis=0) / np.sqrt(len(error))
        assert (np.abs(error.mean(axis=0)) < 4 * standard + 1e-4).all()
        assert (error.std(axis=0) < scatter).all()


def test_passes_have_short_middle_and_long_wavelengths():
    sentinel = tuple(
        box(middle - width / 2, middle + width / 2)
        for middle, width in ((443, 20), (490, 65), (560, 35), (665, 30), (705, 15), (740, 15), (783, 20), (842, 115),
                              (865, 20), (945, 20), (1375, 30), (1610, 90), (2190, 180))
    )  # fmt: skip
    quadrature = BandsBySpectrum(sentinel)
    assert quadrature.nodes() == [1, 2, 1, 1, 1, 1, 1, 3, 1, 1, 1, 3, 4]
    assert quadrature.passes == 7
    for one in (*quadrature.draw(child_rng(0), 3), *ColourBySpectrum().draw(child_rng(0), 3)):
        assert one.channels.wavelength_nm is not None
        assert (np.diff(one.channels.wavelength_nm) > 30).all()
    colour = replace(stand().cameras[0])
    assert isinstance(quadrature_of(colour, "rgb"), ColourAtOnce)
    assert isinstance(quadrature_of(colour, "spectral"), ColourBySpectrum)
    assert isinstance(quadrature_of(replace(colour, bands=sentinel), "rgb"), BandsBySpectrum)
    assert BandsBySpectrum((box(500, 503),)).passes == 1


# The peer: patches as of a chart, a leaf before them and a wall beside, so that light goes from one to another.
PATCHES = [
    smooth(600, 12),
    smooth(480, -20),
    leafy(2.0),
    Spectrum(VISIBLE, np.full(len(VISIBLE), 0.8)),
    smooth(540, 60),
]
LEAF = leafy()
SIZE = (30, 12)


def chart(spectral) -> dict:
    """Surfaces in the frame of a camera at the origin that looks north; `spectral` turns spectra into dictionaries."""
    mi = mitsuba()
    transform = mi.ScalarTransform4f
    scene = {"light": {"type": "constant", "radiance": spectral(WARM)}}
    for k, one in enumerate(PATCHES):
        place = transform().translate([k - 2.0, 4.0, 0.0]).rotate([1, 0, 0], 90).scale([0.5, 0.8, 1.0])
        scene[f"patch{k}"] = {
            "type": "rectangle",
            "to_world": place,
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": spectral(one)}},
        }
    scene["wall"] = {
        "type": "rectangle",
        "to_world": transform().translate([0, 2.9, -1.0]).scale([3.0, 1.2, 1.0]),
        "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": spectral(smooth(600, 12))}},
    }
    scene["leaf"] = {
        "type": "rectangle",
        "to_world": transform().translate([-1.0, 3.6, 0.1]).rotate([1, 0, 0], 60).scale([1.4, 0.25, 1.0]),
        "bsdf": {"type": "principledthin", "base_color": spectral(LEAF), "diff_trans": 1.0, "roughness": 0.5},
    }
    return scene


class Chart:
    """As render/views.py, of the chart."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> np.ndarray:
        mi = mitsuba()

        def spectral(one: Spectrum) -> dict:
            value = [float(x) for x in one.at(channels.wavelength_nm)]
            return {"type": "rgb", "value": value}

        scene = mi.load_dict({"type": "scene", **chart(spectral)})
        seed = 1000 * number[0] + number[1]
        integrator = mi.load_dict({"type": "path", "max_depth": 16})
        return capture(integrator, scene, self.camera, samples=samples, seed=seed)[..., :3]


def peer(camera: Camera, bands: tuple[Band, ...], samples: int, seed: int) -> np.ndarray:
    """(H, W, C) band means by Mitsuba's spectral variant, the current one, and its film of sensor responses."""
    mi = mitsuba()

    def spectral(one: Spectrum) -> dict:
        return {
            "type": "irregular",
            "wavelengths": ", ".join(f"{x:.6f}" for x in one.wavelength_nm),
            "values": ", ".join(f"{x:.9f}" for x in one.value),
        }

    axes, matrix = camera.world_from_camera, np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = -axes[:, 0], -axes[:, 1], axes[:, 2]
    responses = {f"band{k:02d}": spectral(band.response) for k, band in enumerate(bands)}
    film = {"type": "specfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"},
            "component_format": "float32", **responses}  # fmt: skip
    sensor = {"type": "perspective", "fov": camera.hfov_deg, "fov_axis": "x", "film": film,
              "to_world": mi.ScalarTransform4f(matrix), "sampler": {"type": "multijitter"}}  # fmt: skip
    integrator = mi.load_dict({"type": "path", "max_depth": 16})
    scene = mi.load_dict({"type": "scene", **chart(spectral)})
    image = np.array(integrator.render(scene, sensor=mi.load_dict(sensor), seed=seed, spp=samples))
    area = [np.trapezoid(band.response.value, band.response.wavelength_nm) for band in bands]
    return image.astype(np.float64) / area


def test_bands_and_colour_agree_with_the_spectral_renderer(monkeypatch):
    """Means of patches, leaf and wall, bands and colours: within 4.5 standard errors; and of all within 1.5%."""
    colour = colour_science()

    monkeypatch.setattr(wavelengths, "_BAND_STEP_NM", 6.0)  # so that what differs is not a band's few nodes
    monkeypatch.setattr(wavelengths, "_MOST_BAND_NODES", 16)
    camera = Camera("chart", (0.0, 0.0, 0.0), look_at((0, 0, 0), (0, 1, 0)), SIZE, 60.0)
    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    xyz = tuple(
        Band(name, Spectrum(np.asarray(matching.wavelengths), np.asarray(matching.values[:, k])))
        for k, name in enumerate("XYZ")
    )
    bands = (box(440, 470), bell(560, 10), box(600, 630), bell(650, 12), box(710, 740))
    shot = RenderJob(stand(), camera, StoppingCriterion(64), seed=3)
    ours = {"bands": BandsBySpectrum(bands), "colour": ColourBySpectrum()}
    taken = {}
    with using(SCALAR):
        for name, quadrature in ours.items():
            taken[name] = [_replicate(shot, Chart(camera), quadrature, number, 8) for number in range(10)]
    with mitsuba().variant_context("scalar_spectral"):
        taken["peer"] = [peer(camera, bands + xyz, 256, number) for number in range(8)]
    _, response = observer()
    from_xyz = response @ np.linalg.pinv(np.asarray(matching.values).T)  # colour of X, Y and Z
    area = np.array([np.trapezoid(one.response.value, one.response.wavelength_nm) for one in xyz])
    theirs = np.array(taken["peer"])
    compared = {
        "bands": (np.array(taken["bands"]), theirs[..., : len(bands)]),
        "colour": (np.array(taken["colour"]), (theirs[..., len(bands) :] * area) @ from_xyz.T),
    }
    # Columns of the five patches; rows of what is above the leaf, the leaf, and the wall.
    for name, (one, other) in compared.items():
        a, b = one[:, 2:, 5:25].mean(axis=(0, 1, 2)), other[:, 2:, 5:25].mean(axis=(0, 1, 2))
        np.testing.assert_allclose(a, b, rtol=0.015, err_msg=name)
        for rows in (slice(2, 4), slice(5, 7), slice(9, 12)):
            for k in range(5):
                columns = slice(5 + 4 * k, 8 + 4 * k)
                a, b = one[:, rows, columns].mean(axis=(1, 2)), other[:, rows, columns].mean(axis=(1, 2))
                error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
                scale = np.abs(b.mean(axis=0)).max() if name == "colour" else b.mean(axis=0)
                difference = np.abs(a.mean(axis=0) - b.mean(axis=0))
                assert (difference < 4.5 * error + 0.002 * scale).all(), (
                    name,
                    rows,
                    k,
                    difference / scale,
                    error / scale,
                )
                assert (error < 0.08 * scale).all()


def stand(size_px=(48, 27), plants=40) -> SceneSpec:
    """Leaves, bark and soil of real spectra, and the colours of these."""
    bark, soil = smooth(560, 70, 0.06, 0.3), smooth(580, 60, 0.05, 0.35)
    leaf, through = leafy(), leafy(0.8)

    def colour(one: Spectrum) -> tuple[float, float, float]:
        red, green, blue = (float(x) for x in np.clip(colour_of_reflectance(one), 0, 1))
        return red, green, blue

    of_bark = Material(colour(bark), reflectance_spectrum=bark)
    of_leaf = Material(colour(leaf), colour(through), reflectance_spectrum=leaf, transmittance_spectrum=through)
    plain = plain_ground(-12000, 12000)
    ground = replace(
        plain,
        texture=np.broadcast_to(np.float32(colour(soil)), plain.texture.shape).copy(),
        spectrum=soil,
        far_reflectance=colour(soil),
        far_spectrum=soil,
    )
    spec = scattered_scene(plants, size_m=24, exemplars=2, leaves=6000, size_px=size_px, terrain=ground, seed=8)
    # Trunks are thin from afar: the second species' leaves are of bark.
    materials = {key: of_leaf if key == ("kind0", "leaf") else of_bark for key in spec.materials}
    return replace(spec, materials=materials)


def regions(spec: SceneSpec) -> dict[str, np.ndarray]:
    """(H, W) pixels that hold one material."""
    found = identity(spec, 16)
    exemplar = np.append(-1, spec.instances.exemplar)[found.plant_id]
    where = {
        "leaf": (found.part == Part.LEAF) & (exemplar == 0),
        "bark": (found.part == Part.LEAF) & (exemplar == 1),
        "soil": found.part == Part.GROUND,
    }
    pure = {name: samples.mean(axis=2) > 0.8 for name, samples in where.items()}
    assert all(pixels.sum() > 30 for pixels in pure.values())
    return pure


def delta_e(one: np.ndarray, other: np.ndarray, white: np.ndarray) -> float:
    """CIE 2000 difference of two colours, linear Rec. 709, seen under a light whose white is given."""
    colour = colour_science()

    matrix = np.asarray(colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ)
    luminance = (matrix @ white)[1]
    lab = [colour.XYZ_to_Lab(matrix @ value / luminance, colour.XYZ_to_xy(matrix @ white)) for value in (one, other)]
    return float(colour.delta_E(*lab, method="CIE 2000"))


def white_of(spec: SceneSpec, samples: int = 64) -> np.ndarray:
    """(3,) a white level surface in the open."""
    none = replace(spec.instances, **{
        "exemplar": spec.instances.exemplar[:0],
        "transform": spec.instances.transform[:0],
        "plant_id": spec.instances.plant_id[:0],
    })  # fmt: skip
    camera = camera_at((0, 0, 10), (0, 0.1, 0), (8, 8))
    ground = plain_ground(-12000, 12000, albedo=1.0)
    bare = replace(spec, instances=none, terrain=ground, cameras=(camera,), clouds=None)
    return radiance(bare, samples, 1).mean.mean(axis=(0, 1))


@pytest.mark.parametrize("elevation", few([40.0, 15.0]))
def test_colour_and_spectral_images_agree(elevation):
    """Leaves, bark and soil: CIE 2000 difference of their mean colours below 2."""
    spec = replace(stand(), sky=Sky(elevation, 140.0, 3.0))
    colour, spectral = radiance(spec, 64, 1), radiance(spec, 256, 2, mode="spectral")
    assert spectral.channels == colour.channels
    assert (spectral.samples, colour.samples) == (256, 64)
    white = white_of(spec)
    for which, where in regions(spec).items():
        difference = delta_e(colour.mean[where].mean(axis=0), spectral.mean[where].mean(axis=0), white)
        assert difference < 2.0, which


def test_bands_of_the_observer_are_the_luminance():
    """A sensor with the eye's response measures what the colour image says, in its own unit."""
    wavelength, response = observer()
    eye = np.array([0.2126, 0.7152, 0.0722]) @ response
    camera = replace(stand().cameras[0], bands=(Band("eye", Spectrum(wavelength, np.maximum(eye, 0.0))),))
    seen = radiance(replace(stand(), cameras=(camera,)), 240, 1)
    colour = radiance(stand(), 64, 2, mode="spectral")
    luminance = (colour.mean @ [0.2126, 0.7152, 0.0722]).mean()
    assert seen.channels == ("eye",)
    assert seen.mean.shape == (27, 48, 1)
    assert seen.mean.mean() * np.trapezoid(eye, wavelength) == pytest.approx(luminance, rel=0.02)


def test_a_leaf_is_bright_beyond_the_red_edge():
    """NDVI of leaves is far above that of soil; bands have a unit of their own and keep it when denoised."""
    red, nir = box(650, 680, "red"), box(780, 820, "nir")
    spec = stand()
    spec = replace(spec, cameras=(replace(spec.cameras[0], bands=(red, nir)),))
    image = radiance(spec, 32, 1)
    where = regions(spec)
    irradiance = 1.0 / np.pi  # W/m²/nm and steradian, of a clear day, roughly
    for material, low, high in (("leaf", 0.6, 1.0), ("soil", -0.2, 0.35)):
        a, b = image.mean[where[material]].mean(axis=0)
        assert low < (b - a) / (b + a) < high
        assert (np.array([a, b]) < irradiance).all()
    guides = trace_guides(SceneTracer(spec, Timings()), spec.cameras[0])
    clean = denoise_bands(image.mean, guides.colour, guides.normal)
    assert clean.shape == image.mean.shape
    np.testing.assert_allclose(clean.mean(axis=(0, 1)), image.mean.mean(axis=(0, 1)), rtol=0.03)


def test_bands_are_denoised_by_threes():
    """A band's denoised image depends on its own group alone, and not on its unit."""
    rng = np.random.default_rng(1)
    image = rng.gamma(4.0, 0.25, (32, 32, 7)).astype(np.float32)
    clean = denoise_bands(image)
    assert np.isfinite(clean).all()
    assert (clean.std(axis=(0, 1)) < 0.5 * image.std(axis=(0, 1))).all()
    np.testing.assert_allclose(denoise_bands(image[..., 3:6]), clean[..., 3:6], rtol=1e-5)
    scaled = denoise_bands(image * np.float32(1e-3))
    np.testing.assert_allclose(scaled, clean * 1e-3, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(denoise(np.ones((32, 32, 3), np.float32)), 1.0, rtol=0.1)


def test_a_scene_is_repainted_back_and_forth():
    """A view that has shown other wavelengths shows the first ones again, to the last bit."""
    shot = RenderJob(stand((16, 9)), stand((16, 9)).cameras[0], StoppingCriterion(4), seed=1, mode="spectral")
    one, other = Channels((450.0, 550.0, 650.0)), Channels((420.0, 600.0, 800.0))
    with using(SCALAR):
        view = build_view(shot, Silent(), Timings())
        first, between, again = (view.take(channels, 4, (0, 0)) for channels in (one, other, one))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, between)


def test_replicates_share_the_spectrum_evenly():
    """The error from the choice of wavelengths in the mean of 8 replicates: a fifth of what it is for random places."""
    truth = colour_of_radiance(leafy())
    together = [
        np.mean(
            [
                sum(
                    one.weight @ one.channels.of_light(leafy())
                    for one in ColourBySpectrum().draw(child_rng(seed), number)
                )
                for number in range(8)
            ],
            axis=0,
        )
        for seed in range(30)
    ]
    alone = [
        sum(one.weight @ one.channels.of_light(leafy()) for one in ColourBySpectrum().draw(child_rng(seed), 0))
        for seed in range(30)
    ]
    error, random = (np.abs(np.array(one) - truth).mean() / truth.max() for one in (together, alone))
    assert error < random / np.sqrt(8) / 2


def test_replicates_draw_their_own_wavelengths():
    drawn = [ColourBySpectrum().draw(child_rng(7, "wavelengths"), number) for number in range(8)]
    first = {one[0].channels.wavelength_nm for one in drawn}
    assert len(first) == 8


@pytest.mark.slow
def test_colour_and_spectral_images_of_the_quickstart_agree():
    """CIE 2000 difference below 2 in the mean of each material that many pixels show, clouds left out.

    Measured at 32 samples: ground 0.5, leaves of poplar 0.7 and of spruce 0.3, trunks 0.3 and 0.4.
    """
    loaded = load_recipe(Path("recipes/quickstart.yaml"), ["cameras.0.size_px=[192, 108]", "sky.clouds=none"])
    plan = make_plan(loaded.draw(0))
    spec = build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings()).spec
    colour, spectral = radiance(spec, 32, 1), radiance(spec, 64, 2, mode="spectral")
    found, white = identity(spec, 16), white_of(spec)
    kind = np.full(int(spec.instances.plant_id.max()) + 1, -1)
    names = sorted({exemplar.species for exemplar in spec.exemplars})
    kind[spec.instances.plant_id] = [names.index(spec.exemplars[k].species) for k in spec.instances.exemplar]
    compared = 0
    for part, species in itertools.product(np.unique(found.part), range(-1, len(names))):
        where = ((found.part == part) & (kind[found.plant_id] == species)).mean(axis=2) > 0.6
        if part == Part.NOTHING or where.sum() < 60:
            continue
        difference = delta_e(colour.mean[where].mean(axis=0), spectral.mean[where].mean(axis=0), white)
        assert difference < 2.0, (Part(part).name, names[species], difference)
        compared += 1
    assert compared >= 4
