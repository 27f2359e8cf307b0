"""One step of `atmosphere.fluid.air` in plain NumPy: whole arrays, no ghosts at the sides, any precision.

The oracle of the compiled loops, and what they are timed against. Sides are joined and the ground is flat.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from forestgen.atmosphere.fluid.parameters import (
    HEAT_CAPACITY_J_PER_KG_K,
    VAPOUR_LIGHTNESS,
    Physics,
    Surface,
    background,
)
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import GRAVITY_M_PER_S2, LATENT_HEAT_J_PER_KG, Sounding

Array = NDArray[Any]


class PlainAir:
    """The same constructor as `Air`, and a precision."""

    def __init__(
        self, grid: AirGrid, sounding: Sounding, surface: Surface | None, physics: Physics, dtype: Any = np.float64
    ) -> None:
        if surface is not None and surface.height_m is not None:
            raise ValueError("the plain step knows flat ground only")
        self.grid, self.physics, self.surface, self.dtype = grid, physics, surface, dtype
        self.air = background(grid, sounding)
        columns = {
            name: np.asarray(getattr(self.air, name), dtype=dtype)[:, None, None]
            for name in ("vapour", "temperature_ratio", "pressure_pa", "density_kg_per_m3", "lift_per_k")
        }
        self.rest = np.asarray(self.air.potential_temperature_k, np.float32).astype(dtype)[:, None, None]
        self.damp, self.exner, self.pressure = columns["vapour"], columns["temperature_ratio"], columns["pressure_pa"]
        self.density, self.lift_per_k = columns["density_kg_per_m3"], columns["lift_per_k"]
        top = np.arange(grid.cells[2] + 1) / grid.cells[2]
        share = physics.sponge_share
        within = np.clip(1 - (1 - top) / share, 0, 1) if share else 0 * top
        self.calm = (physics.sponge_per_s * np.sin(np.pi / 2 * within) ** 2)[:, None, None]

    def step(self, weather: Weather, step_s: float) -> Weather:
        """The weather one step later."""
        h = self.dtype(step_s)
        wind = tuple(
            np.asarray(field, dtype=self.dtype)
            for field in (weather.east_m_per_s[:, :, :-1], weather.north_m_per_s[:, :-1], weather.up_m_per_s)
        )
        heat = np.asarray(weather.potential_temperature_k, dtype=self.dtype) - self.rest
        vapour, cloud, rain = (np.asarray(q, dtype=self.dtype) for q in (weather.vapour, weather.cloud, weather.rain))
        lift = self._lift(heat, vapour, cloud, rain)
        middle = self._forward(wind, wind, lift, h / 2)
        heat = self._carry_rest(heat, middle[2], h / 2)
        heat = self._carry(heat, middle, h, least=None)
        heat = self._carry_rest(heat, middle[2], h / 2)
        vapour, cloud, rain = (self._carry(q, middle, h, least=0) for q in (vapour, cloud, rain))
        if self.surface is not None:
            mass = self.air.flow_density_kg_per_m3 * self.grid.cell_m[2]
            heat[0] += h * self.surface.heat_w_per_m2 / (mass * HEAT_CAPACITY_J_PER_KG_K * self.exner[0])
            vapour[0] = np.maximum(vapour[0] + h * self.surface.vapour_kg_per_m2_s / mass, 0)
        rain, fallen = self._fall(rain, step_s)
        heat, vapour, cloud, rain = self._change_phases(heat, vapour, cloud, rain, h)
        lift = (lift + self._lift(heat, vapour, cloud, rain)) / 2
        wind = self._confine(wind, middle, h)
        u, v, w = self._forward(wind, middle, lift, h)
        return Weather(
            self.grid,
            weather.time_s + step_s,
            np.concatenate([u, u[:, :, :1]], axis=2),
            np.concatenate([v, v[:, :1]], axis=1),
            w,
            self.rest + heat,
            vapour,
            cloud,
            rain,
            weather.fallen_kg_per_m2 + fallen,
            weather.density_kg_per_m3,
            weather.temperature_ratio,
        )

    def _lift(self, heat: Array, vapour: Array, cloud: Array, rain: Array) -> Array:
        out = np.zeros((heat.shape[0] + 1, *heat.shape[1:]), self.dtype)
        load = self.dtype(VAPOUR_LIGHTNESS) * (vapour - self.damp) - cloud - rain
        gravity = self.dtype(GRAVITY_M_PER_S2)
        out[1:-1] = self.lift_per_k[1:-1] * (heat[1:] + heat[:-1]) / 2 + gravity * (load[1:] + load[:-1]) / 2
        return out

    def _forward(self, base: Any, carrier: Any, lift: Array, h: Any) -> tuple[Array, Array, Array]:
        padded = [_padded(carrier[0], False), _padded(carrier[1], False), _padded(carrier[2], True)]
        out = []
        for axis, (q, old) in enumerate(zip(padded, base, strict=True)):
            change = np.zeros_like(q)
            for a in range(3):
                side = self.dtype(self.grid.cell_m[a])
                change += _flux_difference(q, padded[a], 2 - a, 2 - axis) / (24 * side)
                bend = np.roll(q, 1, 2 - a) + np.roll(q, -1, 2 - a) - 2 * q
                if a == 2 and axis < 2:
                    bend[2] -= 2 * q[2]  # the ground does not slip
                change += self.dtype(self.physics.viscosity_m2_per_s) / side**2 * bend
            layers = old.shape[0]
            out.append(old + h * change[2 : 2 + layers])
        u, v, w = out
        w = (w + h * lift) / (1 + h * self.calm).astype(self.dtype)
        w[0] = w[-1] = 0
        return self._project(u, v, w)

    def _project(self, u: Array, v: Array, w: Array) -> tuple[Array, Array, Array]:
        x, y, z = (self.dtype(side) for side in self.grid.cell_m)
        source = (np.roll(u, -1, 2) - u) / x + (np.roll(v, -1, 1) - v) / y + np.diff(w, axis=0) / z
        nx, ny, nz = self.grid.cells
        spectrum = fft.rfft2(fft.dct(source, axis=0), axes=(1, 2))
        total = (2 * np.sin(np.pi * np.arange(nz) / (2 * nz)) / z)[:, None, None] ** 2
        total = total + (2 * np.sin(np.pi * np.arange(ny) / ny) / y)[:, None] ** 2
        total = total + (2 * np.sin(np.pi * np.arange(nx // 2 + 1) / nx) / x) ** 2
        total[0, 0, 0] = np.inf
        p = fft.idct(fft.irfft2(-spectrum / total.astype(self.dtype), s=(ny, nx), axes=(1, 2)), axis=0)
        w = w.copy()
        w[1:-1] -= np.diff(p, axis=0) / z
        return u - (p - np.roll(p, 1, 2)) / x, v - (p - np.roll(p, 1, 1)) / y, w

    def _carry_rest(self, heat: Array, w: Array, h: Any) -> Array:
        jump = np.zeros_like(w)
        jump[1:-1] = w[1:-1] * np.diff(self.rest, axis=0)
        slope = h / (2 * self.dtype(self.grid.cell_m[2]))
        return np.asarray(heat - slope * (jump[1:] + jump[:-1]))

    def _carry(self, q: Array, wind: Any, h: Any, *, least: float | None) -> Array:
        x, y, z = (field * (h / self.dtype(side)) for field, side in zip(wind, self.grid.cell_m, strict=True))
        one = np.ones_like(q)
        lost_x = (np.roll(x, -1, 2) - x) / 2
        lost = lost_x + (np.roll(y, -1, 1) - y) / 2
        q = _sweep(q, x / 2, one, 1 - lost_x, 2, least)
        q = _sweep(q, y / 2, 1 - lost_x, 1 - lost, 1, least)
        q = _sweep_up(q, z, 1 - lost, 1 + lost, least)
        q = _sweep(q, y / 2, 1 + lost, 1 + lost_x, 1, least)
        return _sweep(q, x / 2, 1 + lost_x, one, 2, least)

    def _fall(self, rain: Array, step_s: float) -> tuple[Array, Array]:
        whole, part = divmod(self.physics.rain_fall_m_per_s * step_s / self.grid.cell_m[2], 1.0)
        cells, share = min(int(whole), rain.shape[0]), self.dtype(part)
        mass = self.air.flow_density_kg_per_m3 * self.grid.cell_m[2]
        lost = rain[:cells].sum(axis=0, dtype=np.float64)
        moved = np.concatenate([rain[cells:], np.zeros_like(rain[:cells])])
        still = np.zeros_like(moved[:1])
        below = np.concatenate([moved[:1], moved[:-1]])
        above = np.concatenate([moved[1:], still])
        flux = share * moved + _bent(below - moved, moved - above, share, 1 - share)
        into = np.concatenate([flux[1:], still])
        return np.maximum(moved - flux + into, 0), mass * (lost + flux[0])

    def _saturation(self, theta: Array) -> tuple[Array, Array]:
        t = self.exner * theta
        saturated = (
            self.dtype(380.16)
            / self.pressure
            * np.exp(self.dtype(17.67) * (t - self.dtype(273.15)) / (t - self.dtype(29.65)))
        )
        return saturated, saturated * self.dtype(17.67 * 243.5) / (t - self.dtype(29.65)) ** 2

    def _change_phases(self, heat: Array, vapour: Array, cloud: Array, rain: Array, h: Any) -> tuple[Array, ...]:
        physics, latent = self.physics, self.dtype(LATENT_HEAT_J_PER_KG / HEAT_CAPACITY_J_PER_KG_K)
        gone, swept = self.dtype(-np.expm1(-physics.autoconversion_per_s * h)), h * self.dtype(physics.accretion_per_s)
        grown = gone * np.maximum(cloud - self.dtype(physics.autoconversion_threshold), 0)
        cloud = cloud - grown
        caught = cloud * (swept * rain) / (1 + swept * rain)
        cloud, rain = cloud - caught, rain + grown + caught
        saturated, slope = self._saturation(self.rest + heat)
        water = self.density / 1000 * rain
        rate = (1 - vapour / saturated) * (1.6 + 124.9 * water**0.2046) * water**0.525
        rate = rate / (5.4e5 + 2.55e6 / (0.01 * self.pressure * saturated)) / (self.density / 1000)
        dried = np.minimum(h * physics.evaporation * rate, (saturated - vapour) / (1 + latent * slope))
        dried = np.where(vapour < saturated, np.minimum(dried, rain), 0).astype(self.dtype)
        rain, vapour, heat = rain - dried, vapour + dried, heat - latent / self.exner * dried
        for _ in range(3):
            saturated, slope = self._saturation(self.rest + heat)
            wet = np.maximum((vapour - saturated) / (1 + latent * slope), -cloud)
            cloud, vapour, heat = cloud + wet, vapour - wet, heat + latent / self.exner * wet
        return heat, vapour, cloud, rain

    def _confine(self, wind: Any, middle: Any, h: Any) -> tuple[Array, Array, Array]:
        strength = self.physics.confinement
        if strength == 0:
            return wind[0], wind[1], wind[2]
        x, y, z = (self.dtype(side) for side in self.grid.cell_m)
        u, v, w = _padded(middle[0], False), _padded(middle[1], False), _padded(middle[2], True)
        u, v, w = (u + np.roll(u, -1, 2)) / 2, (v + np.roll(v, -1, 1)) / 2, (w + np.roll(w, -1, 0)) / 2
        turn = [
            _central(w, 1) / (2 * y) - _central(v, 0) / (2 * z),
            _central(u, 0) / (2 * z) - _central(w, 2) / (2 * x),
            _central(v, 2) / (2 * x) - _central(u, 1) / (2 * y),
        ]
        for part in turn:
            part[1] = part[2]
        turn = [part - part.mean(axis=(1, 2), keepdims=True) for part in turn]
        size = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
        slope = [_central(size, 2) / x, _central(size, 1) / y, _central(size, 0) / z]
        length = np.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2) + self.dtype(1e-6) / x
        push = h / 2 * self.dtype(strength * np.prod(self.grid.cell_m) ** (1 / 3)) * size / length
        east = push * (slope[1] * turn[2] - slope[2] * turn[1])
        north = push * (slope[2] * turn[0] - slope[0] * turn[2])
        up = (push * (slope[0] * turn[1] - slope[1] * turn[0]))[2:-2]
        rise = wind[2].copy()
        rise[:-1] += up
        rise[1:] += up
        return (
            wind[0] + (east + np.roll(east, 1, 2))[2:-2],
            wind[1] + (north + np.roll(north, 1, 1))[2:-2],
            rise,
        )


def _padded(q: Array, upwards: bool) -> Array:
    """Two mirrored layers below and above; what rises is turned."""
    if upwards:
        return np.concatenate([-q[2:0:-1], q, -q[-2:-3:-1]])
    return np.concatenate([q[1::-1], q, q[:-3:-1]])


def _flux_difference(q: Array, speed: Array, axis: int, own: int) -> Array:
    mean = speed + np.roll(speed, 1, own)
    a, b, d = np.roll(q, 2, axis), np.roll(q, 1, axis), np.roll(q, -1, axis)
    flux = mean * (7 * (b + q) - (a + d)) + np.abs(mean) * ((d - a) - 3 * (q - b))
    return np.asarray(flux - np.roll(flux, -1, axis))


def _central(q: Array, axis: int) -> Array:
    return np.asarray(np.roll(q, -1, axis) - np.roll(q, 1, axis))


def _bent(ahead: Array, behind: Array, share: Any, rest: Any) -> Array:
    """What a limited cubic adds to the flux of the upwind value."""
    want = np.abs(share * (1 - share) * ((2 - share) * ahead + (1 + share) * behind) / 6)
    size = np.minimum(want, np.minimum(share * np.abs(ahead), rest * np.abs(behind)))
    return np.asarray(np.where(ahead * behind > 0, np.sign(ahead) * size, 0), dtype=ahead.dtype)


def _faces(a: Array, b: Array, c: Array, d: Array, courant: Array, rest_b: Array, rest_c: Array) -> Array:
    share = np.abs(courant)
    forward = share * b + _bent(c - b, b - a, share, rest_b)
    backward = share * c + _bent(b - c, c - d, share, rest_c)
    return np.where(courant > 0, forward, -backward)


def _sweep(q: Array, courant: Array, before: Array, after: Array, axis: int, least: float | None) -> Array:
    rest = np.maximum(before + np.minimum(courant, 0) - np.maximum(np.roll(courant, -1, axis), 0), 0)
    a, b, d = np.roll(q, 2, axis), np.roll(q, 1, axis), np.roll(q, -1, axis)
    flux = _faces(a, b, q, d, courant, np.roll(rest, 1, axis), rest)
    out: Array = (before * q - (np.roll(flux, -1, axis) - flux)) / after
    return out if least is None else np.maximum(out, least)


def _sweep_up(q: Array, courant: Array, before: Array, after: Array, least: float | None) -> Array:
    rest = np.maximum(before + np.minimum(courant[:-1], 0) - np.maximum(courant[1:], 0), 0)
    wide = np.concatenate([q[:1], q, q[-1:]])
    flux = np.zeros_like(courant)
    flux[1:-1] = _faces(wide[:-3], wide[1:-2], wide[2:-1], wide[3:], courant[1:-1], rest[:-1], rest[1:])
    out = (before * q - np.diff(flux, axis=0)) / after
    return out if least is None else np.maximum(out, least)
