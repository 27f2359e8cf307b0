"""Print how cloud droplets scatter light, for atmosphere/extinction.py: `uv run python docs/spectra/make_droplets.py`.

Mie's solution (Bohren and Huffman 1983, section 4.8) at 550 nm, averaged over Hansen and Travis' (1974) gamma
distribution of radii, n(r) ~ r^((1 - 3 v) / v) exp(-r / (a v)), of effective radius a and effective variance v.
Water's index is Hale and Querry's (1973) at 550 nm, 1.333 + 1.96e-9 i.

Two Henyey-Greenstein lobes have three numbers. Two of them are spent on the asymmetry parameter, which decides how
much light a thick cloud lets through, and on the share that is scattered backwards, by which a thin one is seen from
the sun's side: both are met exactly. The third is chosen so that the logarithm fits best over the sphere. The
diffraction peak, a degree wide, the rainbow and the glory are lost.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

WAVELENGTH_UM, INDEX = 0.55, 1.333 + 1.96e-9j
VARIANCE = 0.1
RADII_UM = (5.0, 8.0, 10.0, 15.0, 20.0)
ANGLES, SIZES = 3000, 400

Floats = NDArray[np.float64]


def mie(size: float, cosine: Floats) -> tuple[float, float, float, Floats]:
    """Efficiencies of extinction and scattering, asymmetry, and intensity by angle of a sphere of size parameter."""
    count = int(size + 4.05 * size ** (1 / 3) + 2)
    inside = INDEX * size
    # Logarithmic derivative, downwards, where that recurrence is stable.
    start = int(max(count, abs(inside)) + 16)
    slope = np.zeros(start + 1, dtype=complex)
    for n in range(start, 0, -1):
        slope[n - 1] = n / inside - 1 / (slope[n] + n / inside)
    a, b = np.zeros(count + 1, dtype=complex), np.zeros(count + 1, dtype=complex)
    psi_before, psi = np.cos(size), np.sin(size)
    chi_before, chi = -np.sin(size), np.cos(size)
    for n in range(1, count + 1):
        psi_next = (2 * n - 1) / size * psi - psi_before
        chi_next = (2 * n - 1) / size * chi - chi_before
        psi_before, psi, chi_before, chi = psi, psi_next, chi, chi_next
        xi, xi_before = psi - 1j * chi, psi_before - 1j * chi_before
        for out, factor in ((a, slope[n] / INDEX + n / size), (b, slope[n] * INDEX + n / size)):
            out[n] = (factor * psi - psi_before) / (factor * xi - xi_before)
    n = np.arange(count + 1)
    extinction = 2 / size**2 * float(((2 * n + 1) * (a + b).real)[1:].sum())
    scattering = 2 / size**2 * float(((2 * n + 1) * (abs(a) ** 2 + abs(b) ** 2))[1:].sum())
    k = n[1:-1]
    along = k * (k + 2) / (k + 1) * (a[1:-1] * a[2:].conj() + b[1:-1] * b[2:].conj()).real
    across = (2 * k + 1) / (k * (k + 1)) * (a[1:-1] * b[1:-1].conj()).real
    asymmetry = 4 / size**2 * float((along + across).sum()) / scattering
    return extinction, scattering, asymmetry, _intensity(a, b, cosine)


def _intensity(a: NDArray[np.complex128], b: NDArray[np.complex128], cosine: Floats) -> Floats:
    first, second = np.zeros(len(cosine), dtype=complex), np.zeros(len(cosine), dtype=complex)
    before, pi = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, len(a)):
        tau = n * cosine * pi - (n + 1) * before
        weight = (2 * n + 1) / (n * (n + 1))
        first += weight * (a[n] * pi + b[n] * tau)
        second += weight * (a[n] * tau + b[n] * pi)
        before, pi = pi, ((2 * n + 1) * cosine * pi - (n + 1) * before) / n
    return np.asarray(abs(first) ** 2 + abs(second) ** 2)


def of_cloud(radius_um: float, cosine: Floats, weight: Floats) -> tuple[float, float, float, Floats]:
    """Mean extinction efficiency, 1 - albedo, asymmetry, and phase function whose mean over the sphere is 1."""
    radius = np.linspace(0.02, 4.0, SIZES) * radius_um
    number = radius ** ((1 - 3 * VARIANCE) / VARIANCE) * np.exp(-radius / (radius_um * VARIANCE))
    area = number * radius**2
    kept = area > 1e-10 * area.max()
    extinction = scattering = asymmetry = 0.0
    phase = np.zeros_like(cosine)
    for r, n, s in zip(radius[kept], number[kept], area[kept], strict=True):
        one = mie(2 * np.pi * r / WAVELENGTH_UM, cosine)
        extinction, scattering = extinction + s * one[0], scattering + s * one[1]
        asymmetry += s * one[1] * one[2]
        phase += n * one[3]
    phase /= 0.5 * (phase * weight).sum()
    return extinction / area[kept].sum(), 1 - scattering / extinction, asymmetry / scattering, phase


def lobe(g: float, cosine: Floats) -> Floats:
    """Henyey and Greenstein's; its mean over the sphere is 1."""
    return np.asarray((1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5)


def backward_share(g: float) -> float:
    """Of a lobe's light, what goes into the backward half: the integral of the line above."""
    if abs(g) < 1e-6:
        return 0.5
    return (1 - g * g) / (2 * g) * (1 / np.sqrt(1 + g * g) - 1 / (1 + g))


def fit(asymmetry: float, backward: float, cosine: Floats, weight: Floats, phase: Floats) -> tuple[float, float, float]:
    """g of the two lobes and share of the first."""

    def lobes(second: float) -> tuple[float, float, float]:
        def excess(first: float) -> float:
            share = (asymmetry - second) / (first - second)
            return share * backward_share(first) + (1 - share) * backward_share(second) - backward

        first = brentq(excess, asymmetry + 1e-6, 0.9999)
        return first, second, (asymmetry - second) / (first - second)

    def misfit(second: float) -> float:
        try:
            first, _, share = lobes(second)
        except ValueError:
            return np.inf
        model = share * lobe(first, cosine) + (1 - share) * lobe(second, cosine)
        return float((weight * np.log(model / phase) ** 2).sum())

    grid = np.linspace(-0.95, 0.8, 176)
    best = grid[int(np.argmin([misfit(float(one)) for one in grid]))]
    return lobes(float(minimize_scalar(misfit, bounds=(best - 0.01, best + 0.01), method="bounded").x))


def report(radius_um: float, cosine: Floats, weight: Floats) -> list[str]:
    """Lines about droplets of one effective radius: sums, fit, and share of the light by angle."""
    extinction, absorbed, asymmetry, phase = of_cloud(radius_um, cosine, weight)
    backward = 0.5 * float((phase * weight)[cosine < 0].sum())
    first, second, share = fit(asymmetry, backward, cosine, weight, phase)
    model = share * lobe(first, cosine) + (1 - share) * lobe(second, cosine)
    lines = [
        f"{radius_um:4.0f} um: efficiency {extinction:.3f}, 1 - albedo {absorbed:.1e}, g {asymmetry:.4f}",
        f"  lobes {first:.4f}, {second:.4f}, share of the first {share:.4f}",
        f"  backward half: Mie {backward:.4f}, one lobe {backward_share(asymmetry):.4f}",
    ]
    for low, high in ((0, 5), (5, 20), (20, 60), (60, 90), (90, 135), (135, 145), (145, 175), (175, 180)):
        of = (cosine <= np.cos(np.radians(low))) & (cosine > np.cos(np.radians(high)))
        mie_part, two, one = (
            0.5 * float((part * weight)[of].sum()) for part in (phase, model, lobe(asymmetry, cosine))
        )
        lines.append(f"  {low:3d}-{high:3d} deg: Mie {mie_part:.4f}, two lobes {two:.4f}, one {one:.4f}")
    return lines


def main() -> None:
    cosine, weight = np.polynomial.legendre.leggauss(ANGLES)
    for radius_um in RADII_UM:
        sys.stdout.write("\n".join(report(radius_um, cosine, weight)) + "\n")


if __name__ == "__main__":
    main()
