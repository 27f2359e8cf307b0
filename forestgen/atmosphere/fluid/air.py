"""Moving air: the Boussinesq equations with heat and water, on a staggered grid (Makowski, chapter 3, Eqs. 32 to 37).

    div u = 0                                                    (32)
    du/dt = -u grad u - grad p / rho + nu lap u + b + f          (33)
    d(theta)/dt = -u grad theta + L / (c_p Pi) (condensation)    (34; L is 2.5e6 J/kg, and condensation warms)
    d(q_v, q_c, q_r)/dt = -u grad q + Kessler's sources          (35 to 37)

One step from t to t + h:

1. the wind half a step on, by its own advection, viscosity and buoyancy; pressure takes its divergence out;
2. heat and water a whole step on with that wind: so both ends of the step see the wind of its middle;
3. heat and vapour from the ground, drops that fall, changes of phase;
4. the wind a whole step on by the middle's advection and the mean of both ends' buoyancy; pressure again.

For gravity waves this is the leapfrog of Stoermer and Verlet: stable up to 2 over their frequency, and it feeds or
damps none. Second order in space and time, but for sources of phase. Constants and limits are in `parameters`.

The wind's fields hold single precision; heat is stepped as its difference from the air at rest. The result does not
depend on the number of threads, and a step on nothing but the weather that it is given: a run that was saved and taken
up again is the same to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.advection import Transport
from forestgen.atmosphere.fluid.microphysics import carry_rest, change_phases, fall, lift
from forestgen.atmosphere.fluid.momentum import Confinement, Pressure, advance_velocity, solid_cells
from forestgen.atmosphere.fluid.parameters import (
    HEAT_CAPACITY_J_PER_KG_K,
    Background,
    Field,
    Physics,
    Surface,
    UnstableError,
    Velocity,
    background,
    check_fields,
    crossing_per_s,
    fixed_limit_s,
    moving_limit_s,
)
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import Sounding, saturation_ratio
from forestgen.core.threads import at_once

_NOISE_SHARE = 0.25  # of the box's height, at least four layers
_OVER = 1.01  # saturation that a sounding may show between its levels
_HALVINGS = 6  # of a step of the solver's own choice, when the air speeds up within it
_INNER = (slice(2, -2),) * 3


def at_rest(
    grid: AirGrid, sounding: Sounding, surface: Surface | None, *, rng: np.random.Generator, noise_k: float = 0.0
) -> Weather:
    """Air in hydrostatic balance that moves with the sounding's wind, around the terrain.

    Potential temperature near the ground is even between plus and minus `noise_k`, cell by cell; there is none at a
    quarter of the box's height. Without any, air above an even ground does not know where to rise.

    Raises ValueError if the sounding is supersaturated in a layer, or the terrain reaches the top layer.
    """
    air = background(grid, sounding)
    most = saturation_ratio(air.potential_temperature_k * air.temperature_ratio, air.pressure_pa)
    worst = int(np.argmax(air.vapour / most))
    if air.vapour[worst] > _OVER * most[worst]:
        raise ValueError(
            f"the sounding is supersaturated at {grid.layer_heights_m[worst]:.0f} m:"
            f" {air.vapour[worst]:.2e} kg/kg of vapour; expected at most {most[worst]:.2e}"
        )
    solid = solid_cells(grid, surface)
    noise = rng.uniform(-noise_k, noise_k, grid.shape)
    fade = np.maximum(1 - np.arange(grid.cells[2]) / max(4, _NOISE_SHARE * grid.cells[2]), 0)[:, None, None]
    u, v, w = _wind_around(grid, air, solid)
    return Weather(
        grid=grid,
        time_s=0.0,
        east_m_per_s=u,
        north_m_per_s=v,
        up_m_per_s=w,
        potential_temperature_k=air.rest_k + (noise * fade).astype(np.float32),
        vapour=np.broadcast_to(air.vapour.astype(np.float32)[:, None, None], grid.shape).copy(),
        cloud=np.zeros(grid.shape, np.float32),
        rain=np.zeros(grid.shape, np.float32),
        fallen_kg_per_m2=np.zeros(grid.shape[1:]),
        density_kg_per_m3=air.density_kg_per_m3,
        temperature_ratio=air.temperature_ratio,
        solid=solid,
    )


def _wind_around(grid: AirGrid, air: Background, solid: NDArray[np.bool_] | None) -> Velocity:
    """The sounding's wind, made to flow around terrain."""
    u, v, w = (np.zeros(tuple(n + 4 for n in grid.shape), np.float32) for _ in range(3))
    u[2:-2], v[2:-2] = air.wind_m_per_s.T.astype(np.float32)[:, :, None, None]
    pressure = Pressure(grid, solid)
    make = pressure.project if solid is not None and air.wind_m_per_s.any() else pressure.set_sides
    make((u, v, w))
    return u[2:-2, 2:-2, 2:-1].copy(), v[2:-2, 2:-1, 2:-2].copy(), w[2:-1, 2:-2, 2:-2].copy()


class Air:
    """Steps the weather of one grid: work space, and the constants of sounding, ground and physics.

    `surface` is what the ground gives off, and terrain; None: nothing, and flat. The grid has at least 4 cells along
    each axis.
    """

    def __init__(self, grid: AirGrid, sounding: Sounding, surface: Surface | None, physics: Physics) -> None:
        self.grid, self.sounding, self.surface, self.physics = grid, sounding, surface, physics
        self.background = background(grid, sounding)
        self.solid = solid_cells(grid, surface)
        self._pressure = Pressure(grid, self.solid)
        self._transport = Transport(grid.shape, self._pressure.openness)
        self._ground = Ground(grid, surface, self.solid, self.background)
        self._confinement = Confinement(grid, physics.confinement, self.solid)
        padded = tuple(n + 4 for n in grid.shape)
        u, v, w, *middle = np.zeros((6, *padded), np.float32)
        self._wind: Velocity = (u, v, w)
        self._middle: Velocity = (middle[0], middle[1], middle[2])
        heat, vapour, cloud, rain = np.zeros((4, *padded), np.float32)
        self._ratios = (heat, vapour, cloud, rain)  # heat: K from rest
        self._lift = np.zeros((grid.cells[2] + 1, *grid.shape[1:]), np.float32)
        self._fixed_limit_s = fixed_limit_s(grid, self.background, physics)
        # (Z + 1,) rate at which vertical motion dies out at the faces: rises as a sine squared to the ceiling.
        height = np.arange(grid.cells[2] + 1) / grid.cells[2]
        within = np.clip(1 - (1 - height) / physics.sponge_share, 0, 1) if physics.sponge_share else 0.0 * height
        self._calm = physics.sponge_per_s * np.sin(np.pi / 2 * within) ** 2
        self._made: Weather | None = None  # the weather that the work space holds, from the last step

    def step(self, weather: Weather, step_s: float | None = None) -> Weather:
        """The weather one step later; None: the largest step that is stable.

        Raises `UnstableError` if the weather is or becomes not finite, or faster than any air, or speeds up too much.
        """
        self._load(weather)
        return self._careful(weather, self._limit_s()) if step_s is None else self._stepped(weather, step_s)

    def run(self, weather: Weather, until_s: float) -> Weather:
        """The weather at a time."""
        while weather.time_s < until_s:
            self._load(weather)
            left = until_s - weather.time_s
            after = self._careful(weather, min(left, self._limit_s()))
            if until_s - after.time_s < 1e-9 * max(1.0, until_s):
                after = replace(after, time_s=float(until_s))
            weather = after
        return weather

    def _careful(self, weather: Weather, step_s: float) -> Weather:
        """A step of the loaded weather of this length, or a shorter one if the air speeds up too much within it."""
        for _ in range(_HALVINGS):
            try:
                return self._stepped(weather, step_s)
            except _TooLongError:
                self._load(weather)
                step_s /= 2
        return self._stepped(weather, step_s)

    def _load(self, weather: Weather) -> None:
        """The weather into the work space."""
        if weather.grid != self.grid:
            raise ValueError(f"the weather has the grid {weather.grid}; this solver's is {self.grid}")
        np.subtract(weather.potential_temperature_k, self.background.rest_k, out=self._ratios[0][_INNER])
        if weather is not self._made:  # else its wind and water are still there
            check_fields(weather)
            u, v, w = self._wind
            u[2:-2, 2:-2, 2:-1], v[2:-2, 2:-1, 2:-2] = weather.east_m_per_s, weather.north_m_per_s
            w[2:-1, 2:-2, 2:-2] = weather.up_m_per_s
            self._pressure.set_sides(self._wind)
            for to, water in zip(self._ratios[1:], (weather.vapour, weather.cloud, weather.rain), strict=True):
                to[_INNER] = water
        lift(self._lift, *self._ratios, self.background, 1.0)

    def _limit_s(self) -> float:
        crossing = crossing_per_s(self._wind, self.grid.cell_m)
        moving = moving_limit_s(crossing, _largest(self._lift), self.grid.cell_m[2], self.physics.courant)
        return min(self._fixed_limit_s, moving)

    def _stepped(self, weather: Weather, step_s: float) -> Weather:
        """One step of the loaded weather."""
        self._made = None
        fallen = weather.fallen_kg_per_m2.copy()
        self._forward(self._wind, self._wind, self._middle, step_s / 2)
        crossing = crossing_per_s(self._middle, self.grid.cell_m)
        if not crossing * step_s < 1:
            cells = crossing * step_s
            raise _TooLongError(
                f"a step of {step_s:.3g} s is too long: the air speeds up and crosses {cells:.2f} cells in it"
            )
        self._carry_ratios(step_s)
        self._exchange(fallen, step_s)
        lift(self._lift, *self._ratios, self.background, 0.5)
        self._confine_and_steer(step_s)
        self._forward(self._wind, self._middle, self._wind, step_s)
        return self._snapshot(weather, fallen, step_s)

    def _forward(self, base: Velocity, carrier: Velocity, out: Velocity, step_s: float) -> None:
        """out = base, moved on by the carrier's advection and the buoyancy, without divergence."""
        advance_velocity(base, carrier, out, step_s, self.grid.cell_m, self.physics.viscosity_m2_per_s)
        w = out[2][3:-2, 2:-2, 2:-2]
        w += np.float32(step_s) * self._lift[1:-1]
        if self._calm.any():
            w *= (1 / (1 + step_s * self._calm[1:-1])).astype(np.float32)[:, None, None]
        self._pressure.project(out)

    def _carry_ratios(self, step_s: float) -> None:
        heat, vapour, cloud, rain = self._ratios
        up, thickness = self._middle[2], self.grid.cell_m[2]
        self._transport.prepare(self._middle, step_s, self.grid.cell_m)
        carry_rest(heat, up, self.background, step_s / 2, thickness)
        self._transport.carry(heat, least=-np.inf)
        carry_rest(heat, up, self.background, step_s / 2, thickness)
        self._transport.carry(vapour)
        for ratio in (cloud, rain):
            if ratio.any():
                self._transport.carry(ratio)

    def _exchange(self, fallen: NDArray[np.float64], step_s: float) -> None:
        """Ground, falling drops, phases."""
        heat, vapour, cloud, rain = self._ratios
        physics, air, thickness = self.physics, self.background, self.grid.cell_m[2]
        self._ground.give(heat, vapour, step_s)
        if physics.rain_fall_m_per_s > 0 and rain[_INNER].any():
            distance = physics.rain_fall_m_per_s * step_s
            fall(rain, fallen, self._ground.lowest, distance, thickness, air.flow_density_kg_per_m3)
        change_phases(heat, vapour, cloud, rain, air, physics, step_s)

    def _confine_and_steer(self, step_s: float) -> None:
        """Forces that act once a step: eddies kept alive, and the mean wind led back to the sounding's."""
        if self.physics.confinement > 0:
            self._confinement.push(self._middle, self._wind, step_s)
        if self.physics.wind_relaxation_s is not None:
            share = -math.expm1(-step_s / self.physics.wind_relaxation_s)
            for axis in range(2):
                inner = self._wind[axis][_INNER]
                missing = self.background.wind_m_per_s[:, axis] - inner.mean(axis=(1, 2), dtype=np.float64)
                inner += (share * missing).astype(np.float32)[:, None, None]

    def _snapshot(self, weather: Weather, fallen: NDArray[np.float64], step_s: float) -> Weather:
        u, v, w = self._wind
        heat, vapour, cloud, rain = (ratio[_INNER] for ratio in self._ratios)
        rest = self.background.rest_k
        parts = (u[2:-2, 2:-2, 2:-1], v[2:-2, 2:-1, 2:-2], w[2:-1, 2:-2, 2:-2], vapour, cloud, rain)
        copies: list[Callable[[], Field]] = [part.copy for part in parts]
        east, north, up, damp, drops, falling, warmth = at_once([*copies, lambda: heat + rest])
        after = replace(
            weather,
            time_s=weather.time_s + step_s,
            east_m_per_s=east,
            north_m_per_s=north,
            up_m_per_s=up,
            potential_temperature_k=warmth,
            vapour=damp,
            cloud=drops,
            rain=falling,
            fallen_kg_per_m2=fallen,
            density_kg_per_m3=self.background.density_kg_per_m3,
            temperature_ratio=self.background.temperature_ratio,
            solid=self.solid,
        )
        check_fields(after)
        fastest = max(at_once([partial(_largest, field) for field in (u, v, w)]))
        if fastest > self.physics.fastest_m_per_s:
            raise UnstableError(
                f"the air has {fastest:.0f} m/s at {after.time_s:.1f} s; expected"
                f" {self.physics.fastest_m_per_s:.0f} or less: shorter steps or weaker heating may help"
            )
        self._made = after
        return after


def _largest(field: Field) -> float:
    return max(float(field.max()), -float(field.min()))


class _TooLongError(UnstableError):
    """The air speeds up within the step."""


class Ground:
    """The lowest air of each column, over `solid` cells (Z, Y, X) or flat ground, and what it receives."""

    def __init__(
        self, grid: AirGrid, surface: Surface | None, solid: NDArray[np.bool_] | None, air: Background
    ) -> None:
        z, y, x = grid.shape
        self.lowest = np.zeros((y, x), np.int64) if solid is None else solid.sum(axis=0)
        self._at = (np.minimum(self.lowest, z - 1) + 2, *np.indices((y, x)) + 2)
        self._warming, self._wetting = (np.zeros((y, x), np.float32),) * 2
        if surface is not None:
            mass = air.flow_density_kg_per_m3 * grid.cell_m[2]
            exner = air.temperature_ratio[np.minimum(self.lowest, z - 1)]
            self._warming = (surface.heat_w_per_m2 / (mass * HEAT_CAPACITY_J_PER_KG_K * exner)).astype(np.float32)
            self._wetting = (surface.vapour_kg_per_m2_s / mass).astype(np.float32)
        self._gives = bool(self._warming.any() or self._wetting.any())

    def give(self, heat: Field, vapour: Field, step_s: float) -> None:
        """Adds a step's emission to fields (Z + 4, Y + 4, X + 4). Dew takes no more vapour than there is."""
        if self._gives:
            heat[self._at] += np.float32(step_s) * self._warming
            vapour[self._at] = np.maximum(vapour[self._at] + np.float32(step_s) * self._wetting, 0)
