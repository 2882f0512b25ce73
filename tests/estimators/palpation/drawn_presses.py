"""Judge: E and ν of drawn slabs from sequences of a tool that presses them, by seed, against their truth.

    python -m tests.estimators.palpation.drawn_presses --bodies 8 --seed 84001

A slab of 90 × 90 × 25 mm, E of 3 to 30 kPa, ν of 0.3 to 0.48, drawn by quadratic elements on another mesh; clouds of
6,000 points with 0.3 mm of noise along the camera's sight, 8 of them at rest; one press, and that and a second one.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import fit_material
from palpate.estimators.palpation.scene import read_scene
from tests.palpated import write_palpation


def drawn(seed: int) -> tuple[float, float, list[tuple[float, tuple[float, float]]]]:
    """E [Pa], ν, and two presses as `write_palpation` takes them."""
    random = np.random.default_rng(seed)
    young, poisson = float(np.exp(random.uniform(np.log(3e3), np.log(3e4)))), float(random.uniform(0.3, 0.48))
    places = [(float(random.uniform(0, 0.35)), float(random.uniform(0, 2 * np.pi))) for _ in range(2)]
    forces = [young * 1.1e-4 * float(random.uniform(0.6, 1.3)) for _ in range(2)]
    return young, poisson, list(zip(forces, places, strict=True))


def main() -> None:
    """Print a line a fit, then how many of the 90 % intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, default=8)
    parser.add_argument("--seed", type=int, default=84001)
    parser.add_argument("--noise", type=float, default=3e-4, help="along the camera's sight [m]")
    options = parser.parse_args()
    held: dict[int, list[bool]] = {1: [], 2: []}
    for seed in range(options.seed, options.seed + options.bodies):
        young, poisson, presses = drawn(seed)
        for count, counted in held.items():
            with tempfile.TemporaryDirectory() as folder:
                path = write_palpation(Path(folder), presses[:count], young, poisson, options.noise, seed=seed)
                begun = time.perf_counter()
                scene = read_scene(path)
                found = fit_material(scene.skin, scene.held, scene.palpations, scene.settings)
            off, half = np.log(found.young / young), NINETY * found.young_sd
            counted.append(abs(off) < half)
            told = (
                f"E {young:.0f} Pa, {100 * np.expm1(off):+.1f} % off (interval ±{100 * half:.1f} %), ν {poisson:.3f}, "
            )
            told += f"{found.poisson:.3f} ± {found.poisson_sd:.3f} ({found.verdict}, {found.stiffens}), "
            print(f"{seed}, {count} pressed: {told}{time.perf_counter() - begun:.0f} s", flush=True)
    for count, counted in held.items():
        print(f"{count} pressed: {sum(counted)} of {len(counted)} intervals of E hold")


if __name__ == "__main__":
    main()
