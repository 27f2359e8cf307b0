"""FRAME/stems.csv: of each plant in view its id, its pixels, and where it stands."""

from __future__ import annotations

from pathlib import Path

from forestgen.dataset.formats.format import DatasetFormat
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame


class StemsCsv(DatasetFormat):
    """Where the plants in view stand."""

    name = "stems_csv"
    bytes_per_plant = 40

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        plants, visible = labelled.population, labelled.views.visible
        rows = zip(plants.plant_id, visible.visible_pixels, plants.position_m, strict=True)
        lines = [f"{number},{pixels},{x:.3f},{y:.3f}\n" for number, pixels, (x, y, _) in rows if pixels]
        (folder / "stems.csv").write_text("plant_id,pixels,x_m,y_m\n" + "".join(lines), encoding="utf-8")


FORMAT = StemsCsv()
