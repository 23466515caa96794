import numpy as np
import pytest

import atomesh


def disc(size: int = 48) -> np.ndarray:
    """Returns a 2-D image of a disc, 2 on it and 0 elsewhere."""
    y, x = np.mgrid[:size, :size]
    return (2.0 * (np.hypot(x - 0.5 * size, y - 0.45 * size) < 0.3 * size)).astype(np.float32)


def ball(shape: tuple[int, int, int] = (26, 30, 34)) -> np.ndarray:
    """Returns a 3-D image of a ball, of shape (nz, ny, nx)."""
    z, y, x = np.mgrid[: shape[0], : shape[1], : shape[2]]
    middle = [0.5 * n for n in shape]
    distance = np.sqrt((z - middle[0]) ** 2 + (y - middle[1]) ** 2 + (x - middle[2]) ** 2)
    return (100 / (1 + np.exp(distance - 8.5))).astype(np.float32)


@pytest.fixture(scope="session")
def faults() -> atomesh.Image:
    return atomesh.synth("faults", dims=(48, 44, 40), count=2)


@pytest.fixture(scope="session")
def mesh(faults: atomesh.Image) -> atomesh.Mesh:
    return atomesh.mesh(faults, distance=6, feature="ridges")


@pytest.fixture(scope="session")
def cells(faults: atomesh.Image) -> atomesh.Mesh:
    return atomesh.voronoi(faults, distance=9, feature="ridges")
