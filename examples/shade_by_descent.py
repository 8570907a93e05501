"""Find the canopy that casts a wanted shade: descent through exact visibility.

A ring of corners spans a canopy over a square. What is wanted is the ambient occlusion of every point of the
square, here that under a star. Every corner may move along all three axes. Values and derivatives are exact
and free of noise, so a quasi-Newton method converges as if the scene were a formula: from a circle back to
the star, to 1e-4.

    python examples/shade_by_descent.py --out docs/shade_by_descent.png
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.optimize import minimize

import silint

N_CORNERS, SIDE, REACH = 20, 32, 1.6


def canopy(corners: np.ndarray) -> silint.Scene:
    """A fan about the mean of its corners (N, 3)."""
    vertices = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
    ring = np.arange(len(corners))
    return silint.Scene(
        vertices, np.stack([ring, np.roll(ring, -1), np.full_like(ring, len(corners))], axis=1)
    )


def corners_of(radii: np.ndarray, tilt: float, height: float) -> np.ndarray:
    """A ring of corners (N, 3) about the z axis."""
    angle = 2.0 * np.pi * np.arange(N_CORNERS) / N_CORNERS
    x, y = radii * np.cos(angle), radii * np.sin(angle)
    return np.stack([x, y, height + tilt * x], axis=1)


def square() -> tuple[np.ndarray, np.ndarray]:
    """Points of the ground, and their normals."""
    at = REACH * (np.arange(SIDE) + 0.5 - 0.5 * SIDE) / (0.5 * SIDE)
    x, y = np.meshgrid(at, at)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(SIDE**2)], axis=1)
    return points, np.broadcast_to([0.0, 0.0, 1.0], points.shape)


def shade(corners: np.ndarray) -> np.ndarray:
    """Exact ambient occlusion of the square under a canopy."""
    ao: np.ndarray = silint.SilhouetteIntegrator(canopy(corners)).ambient_occlusion(*square(), method="exact")
    return ao


def main() -> None:
    """Descend, and draw what was wanted, where it began and what was found."""
    parser = argparse.ArgumentParser(description="Find the canopy that casts a wanted shade.")
    parser.add_argument("--out", default="shade_by_descent.png", help="the picture")
    parser.add_argument("--steps", type=int, default=600, help="of L-BFGS, at most")
    args = parser.parse_args()

    points, normals = square()
    star = corners_of(np.where(np.arange(N_CORNERS) % 4 == 0, 1.4, 0.6), 0.08, 0.25)
    wanted = shade(star)
    errors = []

    def loss(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        sil = silint.SilhouetteIntegrator(canopy(parameters.reshape(-1, 3)))
        difference = sil.ambient_occlusion(points, normals, method="exact") - wanted
        by_vertex = sil.pullback(points, normals, 2.0 * difference / len(points))
        # The middle of the fan is the mean of the corners.
        by_corner = by_vertex[:-1] + by_vertex[-1] / N_CORNERS
        errors.append(np.sqrt((difference**2).mean()))
        return float((difference**2).mean()), by_corner.ravel()

    start = corners_of(np.full(N_CORNERS, 0.8), 0.0, 0.4)
    options = {"maxiter": args.steps, "maxfun": 2 * args.steps, "ftol": 0.0, "gtol": 1e-12, "maxcor": 60}
    found = minimize(loss, start.ravel(), jac=True, method="L-BFGS-B", options=options)
    corners = found.x.reshape(-1, 3)
    draw(args.out, [("wanted", star), ("start", start), (f"after {found.nit} steps", corners)], errors)
    off = np.abs(corners - star).max()
    print(f"RMS error of the shade {errors[0]:.2g} -> {errors[-1]:.2g}; corners are off by {off:.2g} at most")


def draw(path: str, canopies: list[tuple[str, np.ndarray]], errors: list[float]) -> None:
    """The shade under each canopy with its outline from above, and the error by evaluation."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.3), layout="constrained")
    for axis, (title, corners) in zip(axes, canopies, strict=False):
        picture, sides = shade(corners).reshape(SIDE, SIDE), (-REACH, REACH)
        image = axis.imshow(picture, origin="lower", extent=(*sides, *sides), cmap="gray", vmin=0.0, vmax=1.0)
        outline = np.concatenate([corners, corners[:1]])
        axis.plot(outline[:, 0], outline[:, 1], color="tab:orange", linewidth=1.2)
        axis.set(title=title, xticks=[], yticks=[], xlim=sides, ylim=sides)
    figure.colorbar(image, ax=axes[:3], label="ambient occlusion (1 = open)", shrink=0.9)
    axes[3].semilogy(np.minimum.accumulate(errors), color="tab:blue")
    axes[3].set(xlabel="value and gradient evaluated so often", title="RMS error of the shade")
    axes[3].grid(alpha=0.3)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
