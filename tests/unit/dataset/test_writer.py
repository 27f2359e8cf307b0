from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from dataset_shots import SPECIES, make_shot

from forestgen.core.errors import OutputError
from forestgen.dataset import manifest, png
from forestgen.dataset.exr import read_exr
from forestgen.dataset.files import write_bytes, write_json
from forestgen.dataset.tables import write_plants
from forestgen.dataset.writer import frame_bytes, frame_folder_name, write_dataset, write_frame
from forestgen.labels.masks import instance_mask
from forestgen.labels.plants_table import visible_plants

FILES = ["frame.exr", "instance.png", "overlay.png", "plants.parquet", "preview.png", "recipe.yaml", "semantic.png"]


def write(path, shot):
    return write_frame(path, shot.frame, shot.population, SPECIES, "seed: 7  # ü\n", {"seed": "7"})


def test_all_files_agree_and_fit_the_estimate(tmp_path, shot):
    folder = tmp_path / frame_folder_name(0, "camera0")
    record = write(folder, shot)
    assert folder.name == record.folder_name == "000000-camera0"
    assert sorted(path.name for path in folder.iterdir()) == FILES
    identity = read_exr(folder / "frame.exr")["identity"]
    np.testing.assert_array_equal(identity["plant_id"], png.read_instance(folder / "instance.png"))
    assert (folder / "recipe.yaml").read_text(encoding="utf-8") == "seed: 7  # ü\n"
    size = sum(path.stat().st_size for path in folder.iterdir())
    assert size < frame_bytes(shot.frame.camera.size_px, len(shot.population))
    # The population lists oak first, the recipe third: class 2 + 2.
    oak = shot.population.plant_id[shot.population.species == 0]
    assert set(np.unique(identity["semantic"][np.isin(identity["plant_id"], oak)]).tolist()) <= {4}


def test_equal_input_gives_equal_bytes(tmp_path):
    for name in ("a", "b"):
        record = write(tmp_path / name / "000000-camera0", make_shot(range(1, 20)))
        write_dataset(tmp_path / name, [record], SPECIES)
    first, second = (manifest.list_files(tmp_path / name) for name in ("a", "b"))
    assert len(first) == len(FILES) + 1
    assert first == second


def test_wide_ids_fail_before_anything_is_written(tmp_path, wide_shot):
    with pytest.raises(OutputError, match="24 bits"):
        write(tmp_path / "f", wide_shot)
    assert not list((tmp_path / "f").iterdir())


def test_nothing_grows(tmp_path):
    record = write(tmp_path / "f", make_shot([9]))  # the only plant is unseen
    assert record.annotations == ()


def test_plants_table(tmp_path, shot):
    population, samples = shot.population, shot.frame.identity.plant_id
    seen = visible_plants(population.plant_id, samples, instance_mask(samples))
    for name in ("a", "b"):
        write_plants(tmp_path / name, population, seen)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    table = pq.read_table(tmp_path / "a")
    assert b"pandas" not in table.schema.metadata
    assert json.loads(table.schema.metadata[b"forestgen.status"])["3"] == "dead"
    assert table.column("plant_id").to_pylist() == population.plant_id.tolist()
    assert table.column("species").to_pylist()[:2] == ["oak", "poplar"]
    assert table.column("z_m").to_pylist() == population.position_m[:, 2].tolist()
    boxes = list(zip(*(table.column(f"box_{side}").to_pylist() for side in "xywh"), strict=True))
    for row, box in enumerate(boxes):
        assert box == (tuple(seen.box_px[row].tolist()) if seen.has_box[row] else (None,) * 4)
    assert boxes[-1] == (None,) * 4
    assert table.column("visible_area_px").to_pylist() == seen.visible_area_px.tolist()


def test_an_empty_population_has_a_table(tmp_path):
    shot = make_shot([])
    write_plants(
        tmp_path / "p", shot.population, visible_plants(shot.population.plant_id, np.zeros((2, 2, 1), np.uint32),
                                                        np.zeros((2, 2), np.uint32))
    )  # fmt: skip
    assert pq.read_table(tmp_path / "p").num_rows == 0


def test_manifest(tmp_path):
    write_bytes(tmp_path / "a.txt", b"abc")
    (tmp_path / "f").mkdir()
    write_bytes(tmp_path / "f" / "b.txt", b"")
    content = manifest.build_manifest(
        tmp_path, recipe_hash="h", root_seed=7, image_seeds=[np.int64(3)], timings_s={"render": 1.5}
    )
    manifest.write_manifest(tmp_path, content)
    loaded = json.loads((tmp_path / "manifest.json").read_text())
    assert loaded == content
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
