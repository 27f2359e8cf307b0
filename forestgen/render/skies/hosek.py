"""Radiance by direction of Hosek and Wilkie's sky (2012), over its light on a level plane; see skies/clear.py."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, map_directions, row_weights
from forestgen.render.variant import dr, mi, on_device
from forestgen.scene.colour import Channels
from forestgen.scene.spec import towards

NODES_NM = np.arange(320.0, 721.0, 40.0)  # of the model's data
_SPECTRAL = "llvm_ad_spectral"


def radiance_by(shape: NDArray[np.float32], light: Spectrum, channels: Channels) -> NDArray[np.float32]:
    """(..., 3) radiance by a shape (..., nodes) over irradiance, and light on a level plane.

    The radiance is a sum over the nodes, each times a hat function of wavelength.
    """
    hats = (np.interp(light.wavelength_nm, NODES_NM, hat) for hat in np.eye(len(NODES_NM)))
    parts = [channels.of_light(Spectrum(light.wavelength_nm, light.value * hat)) for hat in hats]
    return np.asarray(shape @ np.array(parts, dtype=np.float32))


@lru_cache(maxsize=4)
def hosek_shape(elevation_deg: float, azimuth_deg: float, turbidity: float, albedo: float) -> NDArray[np.float32]:
    """(MAP_ROWS // 2 + 1, columns, nodes) radiance over irradiance on a level plane, 1/sr."""
    directions = map_directions(MAP_ROWS, MAP_COLUMNS)[: MAP_ROWS // 2 + 1]
    directions[-1, :, 2] = 1e-4  # the model has no light at the horizon itself
    flat = directions.reshape(-1, 3).astype(np.float32)
    to_sun = towards(elevation_deg, azimuth_deg)
    before = mi.variant()
    mi.set_variant(_SPECTRAL)
    try:
        emitter: Any = mi.load_dict(
            {"type": "sunsky", "sun_direction": [float(x) for x in to_sun], "turbidity": turbidity, "albedo": albedo,
             "sun_scale": 0.0}
        )  # fmt: skip
        interaction = dr.zeros(mi.SurfaceInteraction3f, len(flat))
        interaction.wi = mi.Vector3f(*(-on_device(mi.Float, flat[:, k]) for k in range(3)))
        values = []
        for first in range(0, len(NODES_NM), 4):
            four = np.resize(NODES_NM[first : first + 4], 4)
            interaction.wavelengths = [float(x) for x in four]
            values.append(np.array(emitter.eval(interaction), dtype=np.float64)[: len(NODES_NM) - first])
    finally:
        mi.set_variant(before)
    radiance = np.maximum(np.concatenate(values), 0.0).T.reshape(*directions.shape[:2], -1)
    irradiance = np.einsum("rck,r->k", radiance, row_weights())
    return np.asarray(radiance / irradiance, dtype=np.float32)
