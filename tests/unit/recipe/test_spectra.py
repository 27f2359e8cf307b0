"""Tables of spectra: what ships is sound and says where it comes from; what is wrong is told with its line."""

import re
from pathlib import Path

import numpy as np
import pytest

from forestgen.core.errors import AssetError
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.spectra import (
    MOST_BYTES,
    MOST_ROWS,
    SEASONS,
    Columns,
    load_bands,
    load_spectra,
    load_table,
    of_season,
    seasons_of,
    sensor_names,
    surface_columns,
    table_text,
)
from support.error_messages import raises_error

SURFACES = [name for name in list_assets("spectra") if not name.startswith(("responses/", "standards/"))]
GOOD = [(400, 0.05, 0.01), (550, 0.15, 0.14), (670, 0.04, 0.01), (800, 0.45, 0.47)]


def table(
    tmp_path: Path, rows: list[tuple[float, ...]], header: str = "wavelength_nm,reflectance,transmittance"
) -> str:
    text = "\n".join(["# source: test", "", header, *(",".join(map(str, row)) for row in rows)])
    (tmp_path / "mine.csv").write_text(text + "\n")
    return "mine.csv"


def read(folder: Path, name: str = "mine.csv", where: str | None = None) -> Columns:
    return surface_columns(table_text(folder / name), str(folder / name), where)


def test_a_table_is_read_as_it_stands(tmp_path):
    columns = read(tmp_path, table(tmp_path, GOOD))
    assert list(columns) == ["reflectance", "transmittance"]
    np.testing.assert_array_equal(columns["transmittance"].wavelength_nm, [400, 550, 670, 800])
    assert columns["reflectance"].at(610.0) == pytest.approx(0.095)
    assert columns["reflectance"].at([300.0, 2500.0]) == pytest.approx([0.05, 0.45])


def test_byte_order_marks_and_line_ends_do_no_harm(tmp_path):
    (tmp_path / "mine.csv").write_bytes("\ufeff# µ\r\nwavelength_nm, reflectance\r\n400, 0.1\r\n700, 0.2\r\n".encode())
    assert read(tmp_path)["reflectance"].at(550.0) == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("rows", "header", "line"),
    [
        ([*GOOD[:2], GOOD[3], GOOD[2]], None, 7),
        ([GOOD[0], *GOOD], None, 5),
        ([(w * 1e-9, r, t) for w, r, t in GOOD], None, 4),
        ([(w * 1e-3, r, t) for w, r, t in GOOD], None, 4),
        ([(w * 10, r, t) for w, r, t in GOOD], None, 4),
        ([(w, 100 * r, 100 * t) for w, r, t in GOOD], None, 4),
        ([*GOOD[:3], (800, 1.2, 0.0)], None, 7),
        ([*GOOD[:3], (800, 0.2, -0.1)], None, 7),
        ([*GOOD[:3], (800, 0.6, 0.5)], None, 7),
        ([*GOOD[:3], (800, "nan", 0.5)], None, 7),
        ([*GOOD[:3], (800, "inf", 0.5)], None, 7),
        ([*GOOD[:3], (800, "", 0.5)], None, 7),
        ([*GOOD[:3], (800, 0.5)], None, 7),
        (GOOD[:1], None, 4),
        ([], None, 3),
        ([(500, 0.1, 0.1), *GOOD[1:]], None, 4),
        (GOOD[:3], None, 6),
        (GOOD, "wavelength,reflectance,transmittance", 3),
        (GOOD, "wavelength_nm;reflectance;transmittance", 3),
        (GOOD, "wavelength_nm,reflectance,reflectance", 3),
        (GOOD, "wavelength_nm,reflectance,albedo", 3),
        (GOOD, "wavelength_nm,transmittance_dry,transmittance", 3),
        (GOOD, "wavelength_nm,reflectance,transmittance_dry", 3),
    ],
)
def test_a_bad_table_is_told_with_its_line(tmp_path, rows, header, line):
    name = table(tmp_path, rows, header or "wavelength_nm,reflectance,transmittance")
    with raises_error(AssetError, place=f"{name}:{line} (named by stand.yaml:3: species.elm)"):
        read(tmp_path, name, "stand.yaml:3: species.elm")


def test_huge_and_binary_files_are_refused(tmp_path):
    name = table(tmp_path, [(400 + k * 0.01, 0.1, 0.1) for k in range(MOST_ROWS + 1)])
    with raises_error(AssetError, place="mine.csv:20004"):
        read(tmp_path, name)
    (tmp_path / name).write_bytes(b"#" * (MOST_BYTES + 1))
    with raises_error(AssetError, place="mine.csv"):
        read(tmp_path, name)
    (tmp_path / name).write_bytes(b"wavelength_nm,reflectance\n\x00\xff")
    with raises_error(AssetError, place="mine.csv:2:2"):
        read(tmp_path, name)
    (tmp_path / name).write_text("# nothing\n\n")
    with raises_error(AssetError, place="mine.csv:1"):
        read(tmp_path, name)


def test_an_unknown_name_meets_the_nearest_one():
    with raises_error(AssetError):
        load_spectra("leaves/brich")
    with raises_error(AssetError):
        load_bands("sentinel_2a")


@pytest.mark.parametrize("name", SURFACES)
def test_a_shipped_surface_is_sound_and_says_whence_it_comes(name):
    columns = load_spectra(name)  # checks fractions, energy and wavelengths
    for spectrum in columns.values():
        assert spectrum.wavelength_nm[0] <= 400
        assert spectrum.wavelength_nm[-1] >= 2400
        assert np.diff(spectrum.value).max() < 0.2  # nothing jumps
    head = find_asset("spectra", name).read_text(encoding="utf-8").split("wavelength_nm,")[0]
    for key in ("# what: ", "# licence: ", "# date: ", "# unit: wavelength in nm", "# source: "):
        assert key in head, (name, key)


def test_every_leaf_has_every_season():
    for name in SURFACES:
        if name.startswith("leaves/") and name not in ("leaves/prospect_reference", "leaves/green_stem"):
            assert seasons_of(load_spectra(name)) == list(SEASONS)


def test_a_season_takes_its_own_columns_or_those_of_all_seasons():
    birch, spruce = load_spectra("leaves/birch"), load_spectra("leaves/spruce")
    assert of_season(birch, "autumn") == (birch["reflectance_autumn"], birch["transmittance_autumn"])
    assert of_season(spruce, "autumn") == (spruce["reflectance"], spruce["transmittance"])
    assert of_season(spruce, "dry") == (spruce["reflectance_dry"], spruce["transmittance_dry"])
    assert of_season({"reflectance_dry": birch["reflectance_dry"]}, "spring") is None


def test_prospect_is_prospects():
    """The row of published values of PROSPECT-D: N 1.5, chlorophyll 40, carotenoids 8, water 0.01, dry matter 0.009."""
    leaf = load_spectra("leaves/prospect_reference")
    for wavelength, r, t in ((550, 0.15117, 0.15025), (670, 0.03635, 0.00607), (800, 0.44254, 0.47463)):
        assert leaf["reflectance"].at(wavelength) == pytest.approx(r, abs=1.1e-5)
        assert leaf["transmittance"].at(wavelength) == pytest.approx(t, abs=1.1e-5)


@pytest.mark.parametrize("name", [name for name in SURFACES if name.startswith("leaves/")])
def test_green_leaves_have_a_red_edge_and_dry_ones_have_none(name):
    for season in SEASONS:
        reflectance, _ = of_season(load_spectra(name), season) or (None, None)
        if reflectance is None:
            continue
        red, infrared = reflectance.at(670), reflectance.at(800)
        index = (infrared - red) / (infrared + red)
        if season == "summer":
            assert index > 0.72  # measured needles of Scots pine have 0.73, see make_leaves.py
        if season == "dry" and f"reflectance_{season}" in load_spectra(name):
            assert index < 0.4


# Reflectance and transmittance at 560, 705, 833 and 1610 nm. Hyytiälä: means of midsummer (Hovi et al. 2024,
# doi:10.23729/9a8d90cd-73e2-438d-9230-94e10e61adc9); Järvselja: the nearest bands of RAMI-V, ACT_HET15.
HYYTIALA = {
    "birch": ((0.111, 0.157, 0.470, 0.317), (0.138, 0.200, 0.486, 0.390)),
    "pine": ((0.184, 0.231, 0.488, 0.241), (0.109, 0.164, 0.410, 0.220)),
    "spruce": ((0.146, 0.197, 0.471, 0.213), (0.114, 0.165, 0.424, 0.219)),
}
JARVSELJA = {"spruce": ((0.117, 0.211, 0.487, 0.219), (0.052, 0.121, 0.364, 0.156))}


@pytest.mark.parametrize("name", HYYTIALA)
def test_leaves_are_near_those_that_were_measured(name):
    """Within 0.035 of the range of the campaigns, which differ by as much (Hovi et al. 2022, Silva Fennica 56, 10683).

    Pine is the mean of two sources, the other of which has more chlorophyll.
    """
    leaf = of_season(load_spectra(f"leaves/{name}"), "summer")
    assert leaf is not None
    for ours, *measured in zip(leaf, HYYTIALA[name], JARVSELJA.get(name, HYYTIALA[name]), strict=True):
        assert ours is not None
        values = ours.at([560.0, 705.0, 833.0, 1610.0])
        assert np.all(values > np.min(measured, axis=0) - 0.035)
        assert np.all(values < np.max(measured, axis=0) + 0.035)


@pytest.mark.parametrize("name", ["cypress", "hemlock", "juniper", "larch", "pine", "sequoia", "spruce"])
def test_needles_have_the_chlorophyll_of_needles(name):
    """25 to 60 µg/cm² of projected area (Zarco-Tejada et al. 2004, Remote Sensing of Environment 89, 189-199)."""
    head = find_asset("spectra", f"leaves/{name}").read_text(encoding="utf-8")
    row = re.search(r"^# (?:all year|summer): (.*)$", head, re.MULTILINE)
    assert row is not None
    assert 25 <= float(row[1].split(", ")[1]) <= 60


def test_every_species_has_a_leaf_of_its_own():
    used: dict[str, str] = {}
    for name in list_assets("species"):
        text = find_asset("species", name).read_text(encoding="utf-8")
        for leaf in set(re.findall(r"spectrum: (leaves/\w+)", text)):
            assert used.setdefault(leaf, name) == name


def test_sentinel_2a_has_esas_bands():
    """Central wavelengths that ESA gives for the responses of Sentinel-2A."""
    centres = {
        "B1": 442.7, "B2": 492.4, "B3": 559.8, "B4": 664.6, "B5": 704.1, "B6": 740.5, "B7": 782.8,
        "B8": 832.8, "B8A": 864.7, "B9": 945.1, "B10": 1373.5, "B11": 1613.7, "B12": 2202.4,
    }  # fmt: skip
    bands = {band.name: band.response for band in load_bands("sentinel2a")}
    assert list(bands) == list(centres)
    for name, response in bands.items():
        centre = np.sum(response.wavelength_nm * response.value) / np.sum(response.value)
        assert centre == pytest.approx(centres[name], abs=0.2)


def test_drone_bands_have_the_published_widths():
    for band, centre, width in zip(
        load_bands("drone_multispectral"), (475, 560, 668, 717, 842), (32, 27, 14, 12, 57), strict=True
    ):
        fine = np.arange(400, 951, 0.05)
        half = fine[band.response.at(fine) >= 0.5]
        assert half.mean() == pytest.approx(centre, abs=0.1)
        assert half[-1] - half[0] == pytest.approx(width, abs=0.3)


@pytest.mark.parametrize("name", sensor_names())
def test_a_band_is_zero_at_its_ends_or_ends_with_its_table(name):
    table = load_table(f"responses/{name}")
    for band in load_bands(name):
        low, high = band.response.wavelength_nm[[0, -1]]
        column = table[band.name]
        outside = (column.wavelength_nm < low) | (column.wavelength_nm > high)
        assert not column.value[outside].any()
        assert band.response.value.min() >= 0
    head = find_asset("spectra", f"responses/{name}").read_text(encoding="utf-8").split("wavelength_nm,")[0]
    assert "# source: " in head
    assert "# licence: " in head


@pytest.mark.parametrize(
    "rows",
    [
        [(450, 0.0), (500, -0.1), (550, 1.0)],
        [(450, 0.0), (500, 0.0)],
        [(200, 1.0), (500, 1.0)],
        [(500, 1.0), (3000, 1.0)],
        [(0.5, 1.0), (0.6, 1.0)],
    ],
)
def test_a_bad_sensor_is_told(tmp_path, rows):
    name = table(tmp_path, rows, "wavelength_nm,red")
    with raises_error(AssetError):
        load_bands(name, folder=tmp_path)


@pytest.mark.parametrize(
    ("header", "response"),
    [
        ("wavelength_nm,red/../../x", "1"),
        ("wavelength_nm,variance.R", "1"),
        ("wavelength_nm,r,R", "1,1"),
        ("wavelength_nm,reflectance", "1"),
        ("wavelength_nm,red", "1e308"),
        ("wavelength_nm,red", "1e-300"),
        ("wavelength_nm,red", "-1"),
        ("wavelength_nm,red", "0"),
    ],
)
def test_what_no_file_or_sum_can_hold_is_told(tmp_path, header, response):
    dark = ",".join("0" for _ in response.split(","))
    (tmp_path / "mine.csv").write_text(f"{header}\n500,{dark}\n550,{response}\n600,{dark}\n")
    with raises_error(AssetError):
        load_bands("mine.csv", folder=tmp_path)


def test_bands_have_names_of_any_language(tmp_path):
    (tmp_path / "mine.csv").write_text("wavelength_nm,bleu foncé,(nir) 2\n500,0,0\n550,1,1\n600,0,0\n")
    assert [band.name for band in load_bands("mine.csv", folder=tmp_path)] == ["bleu foncé", "(nir) 2"]
