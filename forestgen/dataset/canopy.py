"""canopy.json of a fisheye that looks straight up: gap fraction by zenith ring, and what follows from it.

| field | what it is |
|---|---|
| `zenith_deg` | edges of the rings, from the zenith to the horizon |
| `gap_fraction` | by ring: share of sky among what is sky or plant; null where the image shows nothing of it |
| `samples`, `gaps` | by ring: identity samples that met sky or plants; of these, sky |
| `effective_lai` | Miller's integral over the rings of the image |
| `hinge_lai` | of the ring that holds 57.5 degrees |
| `openness` | share of the sky's solid angle that is seen |

labels/gap_fraction.py has the formulas. Ground counts as neither; an area index of all plant matter, wood included.
"""

from __future__ import annotations

import math
from pathlib import Path

from forestgen.dataset.files import write_json
from forestgen.labels.gap_fraction import gap_fraction, looks_up
from forestgen.render.frame import Frame
from forestgen.render.identity import sample_offsets

NAME = "canopy.json"


def write_canopy(folder: Path, frame: Frame) -> None:
    """Write canopy.json if the camera is a fisheye that looks up; a failure raises `OutputError`."""
    if not looks_up(frame.camera):
        return
    identity = frame.identity
    found = gap_fraction(frame.camera, identity.plant_id, identity.part, sample_offsets(identity.plant_id.shape[2]))
    content = {
        "zenith_deg": [round(edge, 9) for edge in found.edges_deg.tolist()],
        "gap_fraction": [_known(share) for share in found.gap_fraction.tolist()],
        "samples": found.samples.tolist(),
        "gaps": found.gaps.tolist(),
        "effective_lai": _known(found.effective_lai),
        "hinge_lai": _known(found.hinge_lai),
        "openness": _known(found.openness),
    }
    write_json(folder / NAME, content)


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
