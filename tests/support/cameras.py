"""A camera of each kind, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from forestgen.core.frames import look_at
from forestgen.scene.spec import Camera, Lens

KINDS = ("perspective", "distorted", "thin lens", "orthographic", "fisheye", "panorama")


#: Of a wide lens of a drone.
DISTORTION = {"k1": -0.28, "k2": 0.11, "p1": 0.0008, "p2": -0.0011, "k3": -0.02}


def camera_of(
    kind: str,
    size_px: tuple[int, int],
    position_m: tuple[float, float, float],
    target_m: tuple[float, float, float] | None = None,
    **about: Any,
) -> Camera:
    """A camera of a kind; by default it looks north, and is 60 degrees (a fisheye 180) or 20 m wide.

    Parameters
    ----------
    about : fields of the camera that differ.
    """
    x, y, z = position_m
    target = (x, y + 1.0, z) if target_m is None else target_m
    plain = Camera("test", position_m, look_at(position_m, target), size_px, 60.0)
    kinds: dict[str, dict[str, Any]] = {
        "perspective": {},
        "thin lens": {"lens": Lens(aperture_radius_m=0.05, focus_m=10.0)},
        "distorted": {"projection": "distorted", "numbers": DISTORTION},
        "orthographic": {"projection": "orthographic", "width_m": 20.0},
        "fisheye": {"projection": "fisheye", "hfov_deg": 180.0},
        "panorama": {"projection": "panorama"},
    }
    return replace(plain, **{**kinds[kind], **about})
