"""An independent checker of the envelope: loops over beams and cells in float64, no code of the package."""
# mypy: disable-error-code="no-untyped-def,no-untyped-call,type-arg,var-annotated"

import math

import numpy as np

ENOUGH, WIDTH, HEIGHT = 5, 1.8, 1.5


def beam_of(point, elevations, columns, rotation):
    """Return ring, column and horizontal range of a point: the ring whose elevation is nearest."""
    x, y, z = (float(c) for c in point)
    flat = math.hypot(x, y)
    ring = min(range(len(elevations)), key=lambda r: abs(z - flat * math.tan(elevations[r])))
    lx, ly = (sum(rotation[i][k] * c for k, c in enumerate((x, y, z))) for i in (0, 1))
    turn = (math.atan2(ly, lx) + math.pi) / (2 * math.pi)
    return ring, min(int(turn * columns), columns - 1), math.hypot(lx, ly)


def depths(points, elevations, columns, rotation, near=0.5, far=100.0):
    """Return the nearest range by (ring, column)."""
    nearest = {}
    for point in points:
        if near <= math.sqrt(sum(float(c) ** 2 for c in point)) <= far:
            ring, column, flat = beam_of(point, elevations, columns, rotation)
            nearest[ring, column] = min(flat, nearest.get((ring, column), math.inf))
    return nearest


def margins(nearest, elevations, columns, rotation, height, cells, half, grade=0.0, far=100.0):
    """Return {cell: margin} on flat ground, or on that of a sensor that stands upright on its own slope."""
    found, step = {}, 2 * half / cells
    normal = [rotation[i][2] for i in range(3)]
    for i in range(cells):
        for j in range(cells):
            x, y = (i + 0.5) * step - half, (j + 0.5) * step - half
            r, a = math.hypot(x, y), math.atan2(y, x)
            found[i, j] = 0
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
                # The beam of this ring above that azimuth: the root of elevation(slope) by bisection.
                low, high = -3.0, 3.0
                for _ in range(60):
                    slope = (low + high) / 2
                    up = normal[0] * math.cos(sector) + normal[1] * math.sin(sector) + normal[2] * slope
                    low, high = (slope, high) if up / math.hypot(1, slope) < math.sin(elevation) else (low, slope)
                z = height + r * slope
                if ground - spread - 0.02 <= z <= ground + spread + HEIGHT:
                    blocked = sum(nearest.get((ring, c % columns), math.inf) < r - step for c in window)
                    found[i, j] += max(0, firings - blocked)
    return np.array([[found[i, j] for j in range(cells)] for i in range(cells)])
