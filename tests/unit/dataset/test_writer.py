from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from dataset_shots import SETTINGS, make_shot

from forestgen.core.errors import OutputError
from forestgen.dataset import manifest, tables
from forestgen.dataset.exr import read_exr
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.tables import write_plants
from forestgen.dataset.writer import frame_bytes, frame_folder_name, write_dataset, write_frame
from forestgen.recipe.registries import DATASET_FORMATS
from support.data_sets import read_instance
from support.error_messages import raises_error

FILES = {
    "camera.json", "frame.exr", "instance.png", "overlay.png", "plants.parquet", "preview.png", "recipe.yaml",
    "semantic.png",
}  # fmt: skip


def write(path, shot):
    write_frame(path, shot.labelled, "seed: 7  # ü\n", {"seed": "7"}, SETTINGS)
    return path


def test_all_files_agree(tmp_path, shot):
    folder = write(tmp_path / frame_folder_name(0, "camera0"), shot)
    assert folder.name == "000000-camera0"
    assert {path.name for path in folder.iterdir()} >= FILES
    identity = read_exr(folder / "frame.exr")["identity"]
    np.testing.assert_array_equal(identity["plant_id"], read_instance(folder / "instance.png"))
    assert (folder / "recipe.yaml").read_text(encoding="utf-8") == "seed: 7  # ü\n"
    # The population lists oak first, the recipe third: class 2 + 2.
    oak = shot.population.plant_id[shot.population.species == 0]
    assert set(np.unique(identity["semantic"][np.isin(identity["plant_id"], oak)]).tolist()) <= {4}


def test_equal_input_gives_equal_bytes(tmp_path):
    for name in ("a", "b"):
        folder = write(tmp_path / name / "000000-camera0", make_shot(range(1, 20)))
        write_dataset(tmp_path / name, [folder], SETTINGS)
    first, second = (manifest.list_files(tmp_path / name) for name in ("a", "b"))
    assert {"coco.json", "classes.json"} < set(first)
    assert first == second


@pytest.mark.parametrize("name", ["", *DATASET_FORMATS])
def test_the_estimate_of_disk_space_holds(tmp_path, name):
    """Everything is noise here, which nothing compresses."""
    shot = make_shot(range(1, 40))
    settings = replace(SETTINGS, formats=(name,) if name else ())
    write_frame(tmp_path / "000000-a", shot.labelled, "", {}, settings)
    write_dataset(tmp_path, [tmp_path / "000000-a"], settings)
    size = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    small = (1 << 18) // 2  # of the estimate's constant part no more than half: the pictures are small
    assert size < frame_bytes(shot.frame.camera.size_px, len(shot.population), settings.formats) - small


def test_formats_are_those_asked_for(tmp_path, shot):
    none = replace(SETTINGS, formats=())
    write_frame(tmp_path / "000000-a", shot.labelled, "", {}, none)
    write_dataset(tmp_path, [tmp_path / "000000-a"], none)
    assert {path.name for path in (tmp_path / "000000-a").iterdir()} == FILES
    assert {path.name for path in tmp_path.iterdir()} == {"000000-a", "classes.json"}


def test_wide_ids_fail_before_anything_is_written(tmp_path, wide_shot):
    with raises_error(OutputError, place="instance.png"):
        write(tmp_path / "f", wide_shot)
    assert not list((tmp_path / "f").iterdir())


def test_every_column_of_the_plants(tmp_path, shot):
    labelled = shot.labelled
    for name in ("a", "b"):
        write_plants(tmp_path / name, labelled)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    table = pq.read_table(tmp_path / "a")
    assert b"pandas" not in table.schema.metadata
    assert json.loads(table.schema.metadata[b"forestgen.status"])["3"] == "dead"
    population, measures, views = labelled.population, labelled.measures, labelled.views
    seen = views.visible
    assert table.column("plant_id").to_pylist() == population.plant_id.tolist()
    assert table.column("species").to_pylist()[:2] == ["oak", "poplar"]
    expected = {
        "z_m": population.position_m[:, 2],
        "visible_area_px": seen.visible_area_px,
        "stem_pixels": views.stem_pixels,
        "adaptation": population.columns["adaptation"],
        "crown_width_m": measures.crown_width_m,
        "dbh_m": measures.dbh_m,
        "leaf_area_m2": measures.leaf_area_m2,
        "exemplar": measures.exemplar,
        "distance_m": views.distance_m,
        "visible_fraction": views.visible_fraction,
        "amodal_area_px": views.amodal_area_px,
        "full_box_right": views.full_box_px[:, 2],
        "truncation": views.truncation,
        "tip_y_px": views.keypoint_px[:, 1, 1],
        "crown_centre_state": views.keypoint_state[:, 2],
    }
    for name, values in expected.items():
        nulls = [None if np.isnan(value) else value for value in values.tolist()]
        assert table.column(name).to_pylist() == nulls, name
    assert None in table.column("dbh_m").to_pylist()
    for name, value in (("dead_form", 1), ("decay_class", 5)):
        assert table.column(name).to_pylist() == [value if dead else None for dead in (population.status == 3).tolist()]
    for name, box, known in [
        ("box", seen.box_px, seen.has_box),
        ("amodal_box", views.amodal_box_px, views.amodal_pixels > 0),
    ]:
        rows = list(zip(*(table.column(f"{name}_{side}").to_pylist() for side in "xywh"), strict=True))
        assert rows == [tuple(box[i].tolist()) if known[i] else (None,) * 4 for i in range(len(box))]
        assert rows[-1] == (None,) * 4  # the last plant is unseen
    assert table.column("amodal_pixels").to_pylist()[-1] is None


def test_the_docstring_names_every_column(tmp_path, shot):
    write_plants(tmp_path / "p", shot.labelled)
    described = tables.__doc__ or ""
    for name in pq.read_schema(tmp_path / "p").names:
        stem = re.sub(r"^(tip|crown_centre)_.*", r"\1_...", name)
        stem = re.sub(r"^(amodal_box|full_box)_(?!x$|left$)", "..._", stem)
        assert re.search(rf"[| ]{re.escape(stem)}[ ,]", described), name


def test_columns_are_those_of_pyarrow():
    rng, null = np.random.default_rng(0), np.arange(21) % 3 == 0
    for kind in ("bool", "uint8", "uint32", "int32", "int64", "float64"):
        values = rng.integers(0, 2 if kind == "bool" else 99, 42).astype(kind)[::2]
        for mask in (None, null, ~null | null):
            assert tables._column(kind, values, mask).equals(pa.array(values.copy(), type=kind, mask=mask))
    index = np.array([2, 0, 1, 1], dtype=np.uint16)
    assert tables._names(("Eiche", "", "Föhre"), index).to_pylist() == ["Föhre", "Eiche", "", ""]


def test_the_plants_are_written_without_pandas(tmp_path):
    """pyarrow imports it to make an array, where it is installed."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\nfrom dataset_shots import make_shot\n"
        "from forestgen.dataset.tables import write_plants\n"
        "write_plants(Path(sys.argv[2]), make_shot(range(1, 5)).labelled)\n"
        "assert 'pandas' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path / "p")], check=True)


def test_an_empty_population_has_a_table(tmp_path):
    write_plants(tmp_path / "p", make_shot([]).labelled)
    assert pq.read_table(tmp_path / "p").num_rows == 0


def test_manifest(tmp_path):
    write_bytes(tmp_path / "a.txt", b"abc")
    (tmp_path / "f").mkdir()
    write_bytes(tmp_path / "f" / "b.txt", b"")
    manifest.write_manifest(
        tmp_path, recipe_hash="h", root_seed=7, image_seeds=[np.int64(3)], timings_s={"render": 1.5}
    )
    loaded = json.loads((tmp_path / "manifest.json").read_text())
    assert (loaded["recipe_hash"], loaded["root_seed"], loaded["image_seeds"]) == ("h", 7, [3])
    assert loaded["timings_s"] == {"render": 1.5}
    assert list(loaded["files"]) == ["a.txt", "f/b.txt"]
    assert loaded["files"]["a.txt"]["bytes"] == 3
    assert loaded["files"]["a.txt"]["sha256"].startswith("ba7816bf")
    assert loaded["versions"]["numpy"] == np.__version__
    assert 1e7 < loaded["peak_memory_bytes"] < 1e12
    assert manifest.is_run_folder(tmp_path)
    write_bytes(tmp_path / "manifest.json", b'{"schema": "other"}')
    assert not manifest.is_run_folder(tmp_path)


def test_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"x": float("nan")})


def test_imports_stay_light():
    heavy = {"OpenEXR", "pyarrow", "pycocotools", "PIL", "mitsuba", "matplotlib"}
    code = "import sys, forestgen.dataset.writer, forestgen.dataset.folder; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not heavy & set(loaded)
