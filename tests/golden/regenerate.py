"""Make the golden reference anew: `uv run python tests/golden/regenerate.py`. Look at it before you commit it."""

from __future__ import annotations

import sys

from stand import FAILURES, REFERENCE, REFERENCE_SEED, build, noise_of, shoot, write_reference


def main() -> None:
    plan, built = build()
    shot = shoot(plan, built, REFERENCE_SEED)
    write_reference(shot)
    seen = len(set(shot.pixels.instance.ravel().tolist()) - {0})
    sys.stdout.write(
        f"{REFERENCE}: {len(built.population)} plants, {seen} in the mask, noise {noise_of(shot.frame):.3f},"
        f" {REFERENCE.stat().st_size:,} bytes; failures go to {FAILURES}\n"
    )


if __name__ == "__main__":
    main()
