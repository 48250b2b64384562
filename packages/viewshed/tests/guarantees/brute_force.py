"""An independent envelope for comparison: loops over beams and cells in float64, without code of the package."""
# mypy: disable-error-code="no-untyped-def,no-untyped-call,type-arg,var-annotated"

import math
from functools import cache

import numpy as np

ENOUGH, WIDTH, HEIGHT = 5, 1.8, 1.5


def depths(points, elevations, columns, rotation, near=0.5, far=100.0):
    """Return the nearest range by (ring, column): the ring whose elevation is nearest to that of a point."""
    nearest = {}
    for x, y, z in ((float(x), float(y), float(z)) for x, y, z in points):
        if near <= math.sqrt(x * x + y * y + z * z) <= far:
            ring = min(range(len(elevations)), key=lambda r: abs(z - math.hypot(x, y) * math.tan(elevations[r])))
            lx, ly = (sum(rotation[i][k] * c for k, c in enumerate((x, y, z))) for i in (0, 1))
            column = min(int((math.atan2(ly, lx) + math.pi) / (2 * math.pi) * columns), columns - 1)
            nearest[ring, column] = min(math.hypot(lx, ly), nearest.get((ring, column), math.inf))
    return nearest


@cache
def slope_of(sine, sector, normal):
    """Return the slope of a beam, given the sine of its elevation and its azimuth, by bisection."""
    low, high = -3.0, 3.0
    for _ in range(60):
        slope = (low + high) / 2
        up = normal[0] * math.cos(sector) + normal[1] * math.sin(sector) + normal[2] * slope
        low, high = (slope, high) if up / math.hypot(1, slope) < sine else (low, slope)
    return slope


def margins(nearest, elevations, columns, rotation, height, cells, half, grade=0.0, far=100.0):
    """Return margins (cells, cells); a tilted sensor stands upright on sloping ground, uncertain by ``grade``."""
    margin, step = np.zeros((cells, cells)), 2 * half / cells
    normal = tuple(float(rotation[i][2]) for i in range(3))
    for i in range(cells):
        for j in range(cells):
            x, y = (i + 0.5) * step - half, (j + 0.5) * step - half
            r, a = math.hypot(x, y), math.atan2(y, x)
            if r <= step or r > far:
                continue
            reach = math.atan2(WIDTH / 2, r) / (2 * math.pi) * columns
            middle = (a + math.pi) / (2 * math.pi) * columns
            window = [c for c in range(-columns, 2 * columns) if middle - reach <= c + 0.5 <= middle + reach]
            firings = math.floor(2 * reach + 1e-6)
            ground = -(normal[0] * x + normal[1] * y) / normal[2] * 20 / max(r, 20)
            spread = grade * max(r - 5, 0)
            sector = (math.floor((a + math.pi) / (2 * math.pi) * 128) % 128 + 0.5) / 128 * 2 * math.pi - math.pi
            for ring, elevation in enumerate(elevations):
                z = height + r * slope_of(math.sin(elevation), sector, normal)
                if ground - spread - 0.02 <= z <= ground + spread + HEIGHT:
                    blocked = sum(nearest.get((ring, c % columns), math.inf) < r - step for c in window)
                    margin[i, j] += max(0, firings - blocked)
    return margin
