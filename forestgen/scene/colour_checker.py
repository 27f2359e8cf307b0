"""A colour chart of 24 patches around a grey card, and what colour science says of it under any light.

The patches' reflectances are those of Ohta (1997), 380 to 780 nm by 5 nm, in colour-science's "ColorChecker N Ohta".
The board is flat and Lambertian, and what lies between and below the patches is the grey card: it reflects 18% at all
wavelengths. So the card tells the light beside each patch, and no patch sees another.

The colour of a patch is its difference, CIE delta E 2000, between the image and

    XYZ = 100 / Y_white * integral of R(lambda) E(lambda) xyz(lambda),  Y_white = integral of E(lambda) y(lambda)

by colour-science's `sd_to_XYZ` ("Integration", CIE 1931 2 degree observer), E the light on the board, R the table.
L*a*b* is taken with the light's own white, a perfect white surface under E.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import colour_temperature
from forestgen.core.parts import Part
from forestgen.core.spectrum import LUMENS_PER_WATT, Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.scene.colour import colour_of_reflectance, colour_science
from forestgen.scene.spec import Camera, Material

CHART = "ColorChecker N Ohta"
COLUMNS, ROWS = 6, 4
GREY = 0.18  # of the card, at all wavelengths
GREY_REGION = COLUMNS * ROWS  # patches are regions 0 to 23, row by row
SPECIES = "colour chart"
PATCH_M, GAP_M, CARD_M = 0.040, 0.006, 0.034  # side of a patch, board between two, card below them
WIDTH_M = COLUMNS * PATCH_M + (COLUMNS + 1) * GAP_M
HEIGHT_M = ROWS * PATCH_M + (ROWS + 1) * GAP_M + CARD_M
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class White:
    """A light by what a perfect white surface under it looks like."""

    luminance_cd_per_m2: float
    xy: Floats  # (2,) CIE 1931
    cct_k: float  # correlated colour temperature; NaN where there is none, see `temperature_of`
    duv: float  # distance from the Planckian locus in CIE 1960 uv, above it positive


@cache
def patches() -> dict[str, Spectrum]:
    """Reflectances of the 24 patches by name, row by row from the upper left."""
    colour = colour_science()

    return {
        str(name): Spectrum(np.asarray(sd.wavelengths, np.float64), np.asarray(sd.values, np.float64))
        for name, sd in colour.SDS_COLOURCHECKERS[CHART].items()
    }


def region_names() -> list[str]:
    """Names of all regions, the grey card last."""
    return [*patches(), "grey card"]


def chart() -> Exemplar:
    """The board in its own frame: x to the right, y to the top, z towards who looks at it, its middle the origin."""
    x = _lines(COLUMNS, 0.0)
    y = _lines(ROWS, CARD_M)
    corners = np.stack(np.meshgrid(x - WIDTH_M / 2, y - HEIGHT_M / 2, [0.0]), axis=-1).reshape(-1, 3)
    cells: dict[int, list[list[int]]] = {region: [] for region in range(GREY_REGION + 1)}
    for j in range(len(y) - 1):
        for i in range(len(x) - 1):
            a = j * len(x) + i
            b, c, d = a + 1, a + 1 + len(x), a + len(x)
            cells[_region(i, j)] += [[a, b, c], [a, c, d]]
    vertices = corners.astype(np.float32)
    organs = tuple(
        OrganMesh(Part.ROCK, str(region), Mesh(vertices, np.asarray(faces, dtype=np.uint32)))
        for region, faces in cells.items()
    )
    return Exemplar(SPECIES, organs, WIDTH_M / 2, 0.0, (WIDTH_M + HEIGHT_M) / 2, 0.0, 0.0)


def _lines(count: int, first_m: float) -> Floats:
    """Where cells begin and end along an axis: gap, patch, gap, ..., the first gap wider by `first_m`."""
    steps = [GAP_M + first_m, *[PATCH_M, GAP_M] * count]
    return np.concatenate([[0.0], np.cumsum(steps)])


def _region(column: int, row: int) -> int:
    """Region of a cell of the board's grid, row 0 at the bottom."""
    if column % 2 == 0 or row % 2 == 0:
        return GREY_REGION
    return (ROWS - 1 - row // 2) * COLUMNS + column // 2


def region_of_face() -> NDArray[np.int64]:
    """(F,) region of each triangle of `chart`, its organs one after another."""
    return np.repeat(np.arange(GREY_REGION + 1), [organ.mesh.triangles for organ in chart().organs])


def reflectances() -> list[Spectrum]:
    """Of all regions, the grey card last."""
    return [*patches().values(), Spectrum(np.array([550.0]), np.array([GREY]))]


@cache
def materials() -> dict[tuple[str, str], Material]:
    """Of `chart`, by (species, material)."""
    result = {}
    for region, spectrum in enumerate(reflectances()):
        red, green, blue = (float(value) for value in colour_of_reflectance(spectrum))
        result[SPECIES, str(region)] = Material((red, green, blue), reflectance_spectrum=spectrum)
    return result


def axes_of(normal: Floats) -> Floats:
    """(3, 3) the board's right, top and normal as columns; of a level board the top is north."""
    normal = normal / np.linalg.norm(normal)
    lean = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(lean, normal)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(normal, right), normal], axis=1)


def transform(point_m: Floats, normal: Floats) -> Floats:
    """(3, 4) of the board at a point."""
    return np.concatenate([axes_of(normal), np.asarray(point_m, dtype=np.float64)[:, None]], axis=1)


def camera(point_m: Floats, normal: Floats, width_px: int, *, away_m: float = 0.8) -> Camera:
    """The camera whose picture the board fills."""
    right, up, towards = axes_of(normal).T
    position = np.asarray(point_m) + away_m * towards
    return Camera(
        name="chart",
        position_m=(float(position[0]), float(position[1]), float(position[2])),
        world_from_camera=np.stack([right, -up, -towards], axis=1),
        size_px=(width_px, round(width_px * HEIGHT_M / WIDTH_M)),
        hfov_deg=float(np.degrees(2 * np.arctan(WIDTH_M / 2 / away_m))),
    )


def white_of(light: Spectrum) -> White:
    """The white of an irradiance in W/m²/nm."""
    xyz = xyz_of_light(light) / np.pi
    total = float(xyz.sum())
    xy = xyz[:2] / total if total > 0 else np.full(2, np.nan)
    cct, duv = temperature_of(light)
    return White(float(xyz[1]), xy, cct, duv)


def xyz_of_light(light: Spectrum) -> Floats:
    """(3,) tristimulus values of a light in W/m²/nm (or W/m²/sr/nm); Y is in lux (cd/m²)."""
    wavelength, matching = _observer()
    return np.asarray(LUMENS_PER_WATT * matching @ light.at(wavelength))


def temperature_of(light: Spectrum) -> tuple[float, float]:
    """Correlated colour temperature in K, and distance from the Planckian locus (Duv).

    NaN where the temperature means nothing: in the dark, at more than 0.05 from the locus, beyond 1000 to 100000 K.
    """
    if not xyz_of_light(light).sum() > 0:
        return float("nan"), float("nan")
    cct, duv = colour_temperature(light)
    if not (abs(duv) <= 0.05 and 1001.0 < cct < 99_000.0):
        return float("nan"), duv
    return cct, duv


def xyz_of_radiance(wavelength_nm: Floats, radiance: NDArray[Any]) -> Floats:
    """(..., 3) tristimulus values of (..., W) radiances at equal steps, W/m²/sr/nm; Y is in cd/m²."""
    known, matching = _observer()
    step = float(wavelength_nm[1] - wavelength_nm[0])
    weights = np.stack([np.interp(wavelength_nm, known, row) for row in matching])
    return np.asarray(LUMENS_PER_WATT * step * (np.asarray(radiance, dtype=np.float64) @ weights.T))


def xyz_of_colour(colour_cd_per_m2: NDArray[Any]) -> Floats:
    """(..., 3) tristimulus values of linear Rec. 709 colours."""
    colour = colour_science()

    matrix = np.asarray(colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ)
    return np.asarray(colour_cd_per_m2 @ matrix.T)


def expected_xyz(light: Spectrum) -> Floats:
    """(25, 3) of all regions by colour-science's integration; a perfect white under the light has Y = 100."""
    colour = colour_science()

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(380, 780, 5))
    grid = np.asarray(observer.wavelengths)
    source = colour.SpectralDistribution(light.at(grid), grid)
    return np.array(
        [
            colour.sd_to_XYZ(colour.SpectralDistribution(one.at(grid), grid), observer, source, method="Integration")
            for one in reflectances()
        ]
    )


def delta_e(found_xyz: Floats, expected: Floats, white_xy: Floats) -> Floats:
    """(...,) CIE delta E 2000 of tristimulus values relative to a white of Y = 100 and this chromaticity."""
    colour = colour_science()

    labs = [colour.XYZ_to_Lab(np.asarray(xyz) / 100.0, white_xy) for xyz in (found_xyz, expected)]
    return np.asarray(colour.delta_E(*labs, method="CIE 2000"), dtype=np.float64)


def shown(xyz: Floats, white_xy: Floats) -> NDArray[np.uint8]:
    """(..., 3) sRGB codes of tristimulus values as an eye that is used to the light sees them (CAT02)."""
    colour = colour_science()

    rgb: Any = colour.XYZ_to_sRGB(np.asarray(xyz) / 100.0, white_xy, chromatic_adaptation_transform="CAT02")
    return np.asarray(np.round(255 * np.clip(rgb, 0.0, 1.0)), dtype=np.uint8)


@cache
def _observer() -> tuple[Floats, Floats]:
    """(W,) nm, (3, W) the observer's matching functions, at its 1 nm steps."""
    colour = colour_science()

    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.asarray(matching.wavelengths), np.asarray(matching.values).T
