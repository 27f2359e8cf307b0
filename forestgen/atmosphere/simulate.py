"""Weather from a scenario: phases of conditions, simulated one after another, and kept on disk.

Time goes in marks of `MARK_S` from the beginning of each phase. What goes on from a mark depends on the state there
alone: a simulation that was interrupted, or that an earlier picture has brought half the way, has the bytes of one that
runs through. At each mark, beside what `fluid.air` does:

- the air below the inversion has cooled by `Conditions.cooling_k_per_h`, as air and fog that radiate do;
- in a story's later phases, each layer's mean temperature and vapour come closer to those of the phase's sounding,
  exp(-t / change_s) of the difference being left, for the first 3 change_s: what weather maps change, and no box of a
  few kilometres can.

A state is found by the hash of all that it depends on: the conditions up to then, the seed, the time and the code.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.conditions import Conditions, Emission
from forestgen.atmosphere.fluid.air import Air, at_rest
from forestgen.atmosphere.fluid.parameters import Physics, Surface
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import LATENT_HEAT_J_PER_KG
from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng

_MOST_BYTES = 4_000_000_000
_Field = NDArray[np.float32]
MARK_S = 60.0
EVERY_S = 20.0  # of work, at least, from one keeping to the next
WIND_RELAXATION_S = 1800.0
_NOISE_K = 0.1
_CHANGES = 3.0  # times change_s, after which the mean air is left to itself
_ONE_PATCH_SHARE = 0.25  # of the box: larger patches are moved so that the warmest lies in its middle
SOURCES = ("atmosphere", "core")  # layers that shape weather
COMPUTED_WITH = ("numpy", "scipy", "numba")


def weather_store() -> DiskCache | None:
    """Where weather is kept; None if there is no place for it."""
    root = cache_root()
    return None if root is None else DiskCache(root / "weather", _MOST_BYTES)


def weather_key(*inputs: Any) -> str:
    """What weather is kept under, by all that it depends on: code, numbers, dataclasses of arrays."""
    return hashlib.blake2b(pack(inputs), digest_size=20).hexdigest()


def read_weather(store: DiskCache, key: str) -> Weather | None:
    """What is kept under a key; None where there is nothing, or nothing that can be read, which is dropped."""
    found: Weather | None = read_packed(store, key, (Weather, AirGrid))
    return found


def regridded(weather: Weather, fresh: Weather) -> Weather:
    """The air of `weather` on the grid of `fresh`, whose values hold above the old ceiling and for the air at rest.

    So where a story goes from fog to thunderheads, cells of 5 m become cells of 200 m. Values are linear between the
    old cells' centres, after a Gaussian as wide as the new cells where those are larger. The old box is periodic at its
    sides. Velocities are interpolated too: they are free of divergence again after the next step's pressure.
    """
    if weather.grid == fresh.grid:
        return replace(weather, density_kg_per_m3=fresh.density_kg_per_m3, temperature_ratio=fresh.temperature_ratio)
    old, new = weather.grid, fresh.grid

    faces = {"east_m_per_s": 2, "north_m_per_s": 1, "up_m_per_s": 0}
    moved: dict[str, Any] = {
        name: _moved(getattr(weather, name), getattr(fresh, name), old, new, faces.get(name))
        for name in (*faces, "potential_temperature_k", "vapour", "cloud", "rain")
    }
    fallen = np.full(new.shape[1:], float(weather.fallen_kg_per_m2.mean()))
    return replace(fresh, time_s=weather.time_s, **moved, fallen_kg_per_m2=fallen)


def _moved(old_values: _Field, fresh: _Field, old: AirGrid, new: AirGrid, faces: int | None) -> _Field:
    """`old_values` on the new grid. `faces`: the axis across which they are faces' values; None: cells' centres."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    wrapped = old_values
    if faces:  # the last face is the first one again
        wrapped = np.take(wrapped, np.arange(wrapped.shape[faces] - 1), axis=faces)
    ratios = [one / other for one, other in zip(new.cell_m[::-1], old.cell_m[::-1], strict=True)]
    sigma = [0.5 * ratio if ratio > 1 else 0.0 for ratio in ratios]
    smooth = gaussian_filter(wrapped, sigma, mode=("nearest", "wrap", "wrap")) if any(sigma) else wrapped
    places = []
    for axis in range(3):
        shift = 0.0 if faces == axis else 0.5
        at_m = new.low_m[2 - axis] + (np.arange(fresh.shape[axis]) + shift) * new.cell_m[2 - axis]
        place = (at_m - old.low_m[2 - axis]) / old.cell_m[2 - axis] - shift
        places.append(place if axis == 0 else np.mod(place, smooth.shape[axis]))
    around = np.pad(smooth, ((0, 0), (0, 1), (0, 1)), mode="wrap")  # between the last cell and the first
    index = np.meshgrid(*places, indexing="ij")
    out = map_coordinates(around, index, order=1, mode="nearest", prefilter=False)
    if faces:  # the last face is the first one, though the new box may be no multiple of the old
        out[(slice(None),) * faces + (-1,)] = out[(slice(None),) * faces + (0,)]
    ceiling_m = old.low_m[2] + old.size_m[2]
    heights = new.low_m[2] + (np.arange(fresh.shape[0]) + (0.0 if faces == 0 else 0.5)) * new.cell_m[2]
    return np.ascontiguousarray(np.where((heights < ceiling_m)[:, None, None], out, fresh), dtype=np.float32)


@dataclass(frozen=True)
class WeatherPhase:
    """Conditions from one moment on."""

    at_s: float
    conditions: Conditions
    change_s: float = 1200.0  # in which the mean air becomes that of the new sounding


@dataclass(frozen=True)
class Scenario:
    """Weather to be simulated: one phase, or a story of several."""

    phases: tuple[WeatherPhase, ...]  # in order; the first begins at 0

    def at(self, time_s: float) -> Conditions:
        """The conditions at a time."""
        return [one for one in self.phases if one.at_s <= time_s][-1].conditions


@dataclass(frozen=True)
class _Stop:
    """A time to which the air is brought in one piece."""

    phase: int
    time_s: float
    mark: bool  # others go on from here


def simulate(
    scenario: Scenario, *, seed: int, until_s: float, progress: Progress, kept: DiskCache | None = None
) -> Weather:
    """The weather at a time after the scenario's beginning.

    `seed` is that of patches on the ground and of the air's first unrest. States are looked for, and kept, in `kept`.
    Raises `UnstableError` if the air cannot be stepped on, ValueError for layers that no air can have.
    """
    stops = list(_stops(scenario, until_s))
    work = _Work(scenario, seed, kept)
    done, weather = work.furthest(stops)
    if done == len(stops) and weather is not None:
        return weather
    with progress.stage("weather", len(stops)) as advance:
        advance(done)
        try:
            for stop in stops[done:]:
                weather = work.to(stop, weather)
                advance(1)
        except BaseException:  # Ctrl-C above all: what was reached is not lost
            work.keep(now=True)
            raise
    work.keep(now=True)
    assert weather is not None
    return weather


def _stops(scenario: Scenario, until_s: float) -> Iterator[_Stop]:
    """Every mark up to a time, and that time."""
    ends = [*(one.at_s for one in scenario.phases[1:]), math.inf]
    for number, (phase, end_s) in enumerate(zip(scenario.phases, ends, strict=True)):
        if phase.at_s > until_s:
            return
        count = math.ceil(round((min(end_s, until_s) - phase.at_s) / MARK_S, 6))
        for index in range(count + 1):
            at_s = min(phase.at_s + index * MARK_S, end_s, until_s)
            if at_s == end_s and index:
                break  # the next phase begins with it
            yield _Stop(number, at_s, mark=at_s < until_s or at_s == phase.at_s + index * MARK_S)


class _Work:
    """One simulation at work."""

    def __init__(self, scenario: Scenario, seed: int, kept: DiskCache | None) -> None:
        self._scenario, self._seed, self._kept = scenario, seed, kept
        self._air: tuple[int, Air] | None = None  # of a phase
        self._newest: dict[str, Weather] = {}  # the last mark, and the state after it: all that others need
        self._written: list[str] = []  # keys of what this simulation has kept
        self._kept_s = time.monotonic()

    def furthest(self, stops: list[_Stop]) -> tuple[int, Weather | None]:
        """How many stops need not be made again, and the state there."""
        if self._kept is None:
            return 0, None
        for count in range(len(stops), 0, -1):
            stop = stops[count - 1]
            if not stop.mark and count < len(stops):
                continue
            found = read_weather(self._kept, self._key(stop))
            if found is not None:
                return count, found
        return 0, None

    def to(self, stop: _Stop, weather: Weather | None) -> Weather:
        """The air at a stop, from that at the one before."""
        if weather is None:
            weather = self._fresh(0)
        before_s = weather.time_s
        # The beginning of a phase is the end of the one before.
        own = stop.phase - (stop.phase > 0 and before_s < self._scenario.phases[stop.phase].at_s)
        if stop.time_s > before_s:
            weather = self._air_of(own).run(weather, stop.time_s)
            weather = self._forced(replace(weather, time_s=stop.time_s), own, stop.time_s - before_s)
        if stop.phase != own:
            weather = self._entered(weather, stop.phase)
        if stop.mark:
            self._newest = {}  # the state at a mark is all that later ones need
        self._newest[self._key(stop)] = weather
        self.keep()
        return weather

    def keep(self, *, now: bool = False) -> None:
        """Write the newest mark and state, where they are not kept yet, and then remove the marks on the way there.

        Unless it must be `now`, at most every `EVERY_S` seconds.
        """
        if self._kept is None or not (now or time.monotonic() - self._kept_s >= EVERY_S):
            return
        for key, weather in self._newest.items():
            if key not in self._written and self._kept.write(key, pack(weather)):
                self._written.append(key)
        if any(key in self._written for key in self._newest):  # else there is no better one to go on from
            for key in [one for one in self._written if one not in self._newest]:
                self._kept.drop(key)
                self._written.remove(key)
        self._kept.trim()
        self._kept_s = time.monotonic()

    def _key(self, stop: _Stop) -> str:
        until_then = self._scenario.phases[: stop.phase + 1]
        return weather_key(code_hash(SOURCES, COMPUTED_WITH), self._seed, stop.time_s, until_then)

    def _fresh(self, number: int) -> Weather:
        conditions = self._scenario.phases[number].conditions
        rng = child_rng(self._seed, "weather", "unrest")
        grid, sounding = conditions.domain.grid(), conditions.sounding()
        return at_rest(grid, sounding, self._surface(conditions), rng=rng, noise_k=_NOISE_K)

    def _surface(self, conditions: Conditions) -> Surface:
        emission, grid = conditions.emission, conditions.domain.grid()
        pattern = emission_pattern(emission, grid, child_rng(self._seed, "weather", "emission"))
        vapour = emission.latent_w_per_m2 / LATENT_HEAT_J_PER_KG
        return Surface((emission.heat_w_per_m2 * pattern).astype(np.float32), (vapour * pattern).astype(np.float32))

    def _air_of(self, number: int) -> Air:
        if self._air is None or self._air[0] != number:
            conditions = self._scenario.phases[number].conditions
            physics = Physics(wind_relaxation_s=WIND_RELAXATION_S)
            air = Air(conditions.domain.grid(), conditions.sounding(), self._surface(conditions), physics)
            self._air = (number, air)
        return self._air[1]

    def _entered(self, weather: Weather, number: int) -> Weather:
        """The air as a phase takes it over, with new unrest: a larger box must not go on repeating the old."""
        fresh = self._fresh(number)
        theta = fresh.potential_temperature_k
        unrest = theta - theta.mean(axis=(1, 2), keepdims=True)
        taken = regridded(weather, fresh)
        return replace(taken, potential_temperature_k=taken.potential_temperature_k + unrest)

    def _forced(self, weather: Weather, number: int, seconds: float) -> Weather:
        """Cooled, and pushed towards the phase's sounding: what acts over the whole of a layer."""
        phase = self._scenario.phases[number]
        conditions = phase.conditions
        height = weather.grid.layer_heights_m
        cooling_k = conditions.cooling_k_per_h / 3600 * seconds / weather.temperature_ratio
        warmer = np.where(height < conditions.inversion_m, -cooling_k, 0.0)
        moister = np.zeros_like(warmer)
        if number and weather.time_s - phase.at_s <= _CHANGES * phase.change_s:
            share = 1.0 - math.exp(-seconds / phase.change_s)
            sounding = conditions.sounding()
            theta = weather.potential_temperature_k.mean(axis=(1, 2), dtype=np.float64)
            vapour = weather.vapour.mean(axis=(1, 2), dtype=np.float64)
            warmer += share * (sounding.potential_temperature_at(height) - theta)
            moister += share * (sounding.vapour_at(height) - vapour)
        if not (warmer.any() or moister.any()):
            return weather
        return replace(
            weather,
            potential_temperature_k=weather.potential_temperature_k + _layers(warmer),
            vapour=np.maximum(weather.vapour + _layers(moister), np.float32(0)),
        )


def _layers(values: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(values, dtype=np.float32)[:, None, None]


def emission_pattern(emission: Emission, grid: AirGrid, rng: np.random.Generator) -> NDArray[np.float32]:
    """(Y, X) of mean 1: how the ground's emission differs from place to place."""
    across = grid.shape[1:]
    if emission.map is not None:
        from scipy.ndimage import map_coordinates

        rows, columns = (
            (np.arange(count) + 0.5) / count * size - 0.5
            for count, size in zip(across, emission.map.shape, strict=True)
        )
        index = np.meshgrid(rows, columns, indexing="ij")
        values = map_coordinates(emission.map.astype(np.float64), index, order=1, mode="nearest")
        return np.asarray(values / values.mean(), dtype=np.float32)
    noise = _patches(across, grid.cell_m[:2][::-1], emission.patch_m, rng)
    if emission.patch_m > _ONE_PATCH_SHARE * min(grid.size_m[:2]):
        row, column = np.unravel_index(int(np.argmax(noise)), across)
        noise = np.roll(noise, (across[0] // 2 - int(row), across[1] // 2 - int(column)), (0, 1))
    values = np.maximum(1.0 + emission.contrast * noise, 0.0)
    return np.asarray(values / values.mean(), dtype=np.float32)


def _patches(
    shape: tuple[int, ...], cell_m: tuple[float, ...], patch_m: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Periodic Gaussian noise of unit variance whose wavelengths lie about twice the size of a patch."""
    import scipy.fft

    white = rng.standard_normal(shape)
    k = np.hypot(*np.meshgrid(*(scipy.fft.fftfreq(n, d) for n, d in zip(shape, cell_m, strict=True)), indexing="ij"))
    longest = max(n * d for n, d in zip(shape, cell_m, strict=True))
    centre = max(1.0 / (2.0 * patch_m), 1.0 / longest)  # the box holds no longer wave
    amplitude = np.where(k > 0, np.exp(-0.5 * ((k - centre) / (0.35 * centre)) ** 2), 0.0)
    noise = scipy.fft.ifftn(scipy.fft.fftn(white) * amplitude).real
    return np.asarray((noise - noise.mean()) / noise.std())
