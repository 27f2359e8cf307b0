"""Which wavelengths an image's passes are rendered at, and how its channels are made of them.

A pass holds three wavelengths, a short, a middle and a long one. The channels of an image are integrals over
wavelength, c = integral of r_c(l) L(l) dl, and are estimated by N nodes: the density p of the nodes is cut into N
strata of equal share, a node lies at the same random place u in each of them, and c = sum of r_c(l_k) L(l_k) /
(N p(l_k)). u is uniform, so the estimate is unbiased; from replicate to replicate it goes on by the golden ratio, so
that all places together are even, and the mean's error from the choice of wavelengths is smaller than the replicates'
scatter says.

- Colour: 12 nodes, 4 passes. One u for all nodes (Cranley and Patterson 1976), since the responses fade out at both
  ends: the rule is then one of a periodic function. p is the cube root of the sum of the responses' sizes. Measured on
  sunlight, skylight and a flat light on white, leaf and red: standard deviation of a channel in a replicate 0.4 to
  2.2%; with p in proportion to the responses 8 to 31%, with independent places in the strata 9 to 21%.
- Bands: each has nodes of its own, p in proportion to its response times the light in the open, so that all count
  alike: water vapour takes nine tenths of the light from parts of some bands. One node for each 40 nm of a band's
  width, at most 4, and what is left over in the last pass goes to the widest. Bands share passes, not nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Band, Spectrum
from forestgen.scene.colour import RGB, Channels, colour_of_radiance, observer
from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]
Mode = Literal["rgb", "spectral"]

COLOUR_NODES = 12
_COLOUR_POWER = 1.0 / 3.0
_BAND_STEP_NM = 40.0
_MOST_BAND_NODES = 4
_BAND_BINS = 256
_GOLDEN = (5**0.5 - 1) / 2
_LEAST_LIGHT = 1e-3  # of a band's mean, so that no wavelength is left out


@dataclass(frozen=True)
class Pass:
    """One capture of the scene."""

    channels: Channels
    weight: Floats  # (C, 3): an image's channels from the pass' own


class Quadrature:
    """How an image's channels are made of passes."""

    names: tuple[str, ...] = ("R", "G", "B")
    bands: tuple[Band, ...] = ()  # of the channels; none: linear Rec. 709
    passes: int = 1  # of a replicate

    def of_light(self, spectrum: Spectrum) -> list[float]:
        """Of a spectrum per nm, what the channels hold of it."""
        return [float(value) for value in colour_of_radiance(spectrum)]

    def draw(self, rng: np.random.Generator, number: int) -> tuple[Pass, ...]:
        """The passes of a replicate; `rng` is the image's, at its beginning."""
        raise NotImplementedError


class ColourAtOnce(Quadrature):
    """One pass in linear Rec. 709."""

    def draw(self, rng: np.random.Generator, number: int) -> tuple[Pass, ...]:
        return (Pass(RGB, np.eye(3)),)


class ColourBySpectrum(Quadrature):
    """Linear Rec. 709 from wavelengths."""

    passes = COLOUR_NODES // 3

    def draw(self, rng: np.random.Generator, number: int) -> tuple[Pass, ...]:
        wavelength, response = observer()
        size = np.abs(response).sum(axis=0) ** _COLOUR_POWER
        density = np.interp((wavelength[:-1] + wavelength[1:]) / 2, wavelength, size)
        node_nm, per_nm = _nodes(wavelength, density, COLOUR_NODES, _place(rng, number))
        value = np.stack([np.interp(node_nm, wavelength, row) for row in response])
        return _passes(node_nm, value / (COLOUR_NODES * per_nm))


class BandsBySpectrum(Quadrature):
    """A sensor's bands from wavelengths, under the scene's light, of any scale; None: equal at all of them."""

    def __init__(self, bands: tuple[Band, ...], light: Spectrum | None = None) -> None:
        self.bands, self._light = bands, light
        self.names = tuple(band.name for band in bands)
        self.passes = sum(self.nodes()) // 3

    def nodes(self) -> list[int]:
        """Of each band; their sum is a multiple of three."""
        width = np.array([_width_nm(band) for band in self.bands])
        count = np.clip(np.ceil(width / _BAND_STEP_NM), 1, _MOST_BAND_NODES).astype(int)
        while count.sum() % 3:
            count[np.argmax(width / count)] += 1
        return [int(one) for one in count]

    def of_light(self, spectrum: Spectrum) -> list[float]:
        return [band.mean(spectrum) for band in self.bands]

    def draw(self, rng: np.random.Generator, number: int) -> tuple[Pass, ...]:
        places, rows = [], []
        for index, (band, count) in enumerate(zip(self.bands, self.nodes(), strict=True)):
            edges, response = _bins(band)
            node_nm, per_nm = _nodes(edges, self._density(edges, response), count, _place(rng, number))
            weight = np.interp(node_nm, edges, response) / np.trapezoid(response, edges) / (count * per_nm)
            rows.append(np.zeros((len(self.bands), count)))
            rows[-1][index] = weight
            places.append(node_nm)
        return _passes(np.concatenate(places), np.concatenate(rows, axis=1))

    def _density(self, edges_nm: Floats, response: Floats) -> Floats:
        """(B,) of a band's nodes, by bin: the light that the band answers to there."""
        weight = response
        if self._light is not None:
            light = self._light.at(edges_nm)
            weight = response * (light + _LEAST_LIGHT * light.mean()) if light.any() else response
        return weight[:-1] + weight[1:]


def quadrature_of(camera: Camera, mode: Mode, light: Spectrum | None = None) -> Quadrature:
    """Of a camera's image under a light: a camera with bands is always rendered at wavelengths."""
    if camera.bands:
        return BandsBySpectrum(camera.bands, light)
    return ColourBySpectrum() if mode == "spectral" else ColourAtOnce()


def _nodes(edges_nm: Floats, density: Floats, count: int, place: float) -> tuple[Floats, Floats]:
    """(count,) nm, the same `place` in [0, 1) of each of `count` strata; (count,) the density there, per nm.

    The density (B,), of any scale, is constant in bins between `edges_nm` (B + 1,).
    """
    lit = density > 0
    start, density = edges_nm[:-1][lit], density[lit]
    total = np.concatenate([[0.0], np.cumsum(density * np.diff(edges_nm)[lit])])
    at = (np.arange(count) + place) / count * total[-1]
    bin_ = np.clip(np.searchsorted(total, at, side="right") - 1, 0, len(start) - 1)
    node = start[bin_] + (at - total[bin_]) / density[bin_]
    return node, density[bin_] / total[-1]


@lru_cache(maxsize=256)
def _bins(band: Band) -> tuple[Floats, Floats]:
    """Wavelengths so fine that the response is a straight line between any two, and its values there, at least 0."""
    own = band.response.wavelength_nm
    edges = np.union1d(own, np.linspace(own[0], own[-1], _BAND_BINS + 1))
    return edges, np.maximum(band.response.at(edges), 0.0)


def _place(rng: np.random.Generator, number: int) -> float:
    """A replicate's place in the strata: drawn once an image, then in steps of the golden ratio."""
    return float((rng.random() + number * _GOLDEN) % 1.0)


def _width_nm(band: Band) -> float:
    """Of the box that has the response's integral and that of its square."""
    edges, response = _bins(band)
    return float(np.trapezoid(response, edges) ** 2 / np.trapezoid(response**2, edges))


def _passes(node_nm: Floats, weight: Floats) -> tuple[Pass, ...]:
    """Nodes (N,) and (C, N) dealt out so that each pass has short, middle and long ones."""
    order = np.argsort(node_nm, kind="stable")
    count = len(order) // 3
    passes = []
    for k in range(count):
        own = order[k::count]
        short, middle, long = (float(value) for value in node_nm[own])
        passes.append(Pass(Channels((short, middle, long)), weight[:, own]))
    return tuple(passes)
