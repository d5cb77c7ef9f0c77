"""Levelling to the byte: as its specification reads, return by return, and one golden scan."""

import hashlib
import math
from itertools import accumulate

import numpy as np
import pytest

from core.projection.ground import GroundPlane, ground_plane
from core.projection.levelling import level
from core.scans.scan import Scan

HEIGHT_M = 1.73


def plane_by_loop(points_m, height):
    """Return slopes and offset with plain numbers, as the specification in `ground` reads."""
    cells = lowest(points_m)
    shallowest, deepest = max(0.4 * height, height - 1.5), min(2.2 * height, height + 1.5)
    plane = consensus(cells, shallowest, deepest)
    for tolerance in (0.3, 0.2, 0.15, 0.15):
        agree = [cell for cell in cells if abs(above(plane, cell)) <= tolerance]
        if len(agree) < 20:
            return None
        plane = least_squares(agree)
    return plane if supported(plane, cells, height, shallowest, deepest) else None


def lowest(points_m):
    cells: dict[tuple[int, int], tuple[float, ...]] = {}
    for x, y, z in points_m.tolist():
        i, j = math.floor(x / 2.0), math.floor(y / 2.0)
        if i in (-1, 0) and j in (-1, 0):
            continue
        if (2 * i + 1) ** 2 + (2 * j + 1) ** 2 < 24 * 24:
            cells[i, j] = min(cells.get((i, j), (math.inf,)), (z, x, y))
    return [cells[cell] for cell in sorted(cells)]


def consensus(cells, shallowest, deepest):
    bins = max(4, math.ceil((deepest - shallowest) * 20.0))
    slopes = [(i, j) for i in range(-10, 11) for j in range(-10, 11) if i * i + j * j <= 100]
    best = (-math.inf, (0.0, 0.0, 0.0))
    for i, j in sorted(slopes, key=lambda slope: slope[0] ** 2 + slope[1] ** 2):
        a, b = i / 50.0, j / 50.0
        counts = [0] * bins
        for z, x, y in cells:
            at = math.floor((z - (a * x + b * y) + deepest) * 20.0)
            if 0 <= at < bins:
                counts[at] += 1
        for k in range(bins - 3):
            score = 4 * sum(counts[k : k + 4]) - 6 * sum(counts[max(0, k - 10) : max(0, k - 1)])
            if score - i * i - j * j > best[0]:
                best = (score - i * i - j * j, (a, b, (k + 2.0) / 20.0 - deepest))
    return best[1]


def above(plane, cell):
    z, x, y = cell
    return z - (plane[0] * x + plane[1] * y + plane[2])


def total(values):
    return list(accumulate(values))[-1]


def centred(values):
    middle = total(values) / len(values)
    return [value - middle for value in values], middle


def least_squares(cells):
    (z, mz), (x, mx), (y, my) = (centred(values) for values in zip(*cells, strict=True))
    product = {
        name: total(p * q for p, q in zip(*pair, strict=True))
        for name, pair in {
            "xx": (x, x),
            "xy": (x, y),
            "yy": (y, y),
            "xz": (x, z),
            "yz": (y, z),
        }.items()
    }
    xx, yy, xy = product["xx"] + 50.0, product["yy"] + 50.0, product["xy"]
    determinant = xx * yy - xy * xy
    a = (yy * product["xz"] - xy * product["yz"]) / determinant
    b = (xx * product["yz"] - xy * product["xz"]) / determinant
    return a, b, mz - (a * mx + b * my)


def supported(plane, cells, height, shallowest, deepest):
    agree = [cell for cell in cells if abs(above(plane, cell)) <= 0.15]
    depth = -plane[2] * (1.0 / math.sqrt(1.0 + plane[0] * plane[0] + plane[1] * plane[1]))
    if len(agree) < 20 or not shallowest <= depth <= deepest:
        return False
    if plane[0] * plane[0] + plane[1] * plane[1] > 0.22 * 0.22:
        return False
    _, (x, _), (y, _) = (centred(values) for values in zip(*agree, strict=True))
    xx, yy = total(p * p for p in x), total(q * q for q in y)
    xy = total(p * q for p, q in zip(x, y, strict=True))
    narrow = (xx + yy) / 2.0 - math.sqrt(((xx - yy) / 2.0) * ((xx - yy) / 2.0) + xy * xy)
    rough = math.sqrt(total(above(plane, cell) * above(plane, cell) for cell in agree) / len(agree))
    share = 0.15 + 2.5 * max(0.0, (height - depth) / height - 0.05)
    share = share + 10.0 * max(0.0, rough - 0.05)
    share = share + sum(above(plane, cell) < -0.15 for cell in cells) / len(cells)
    return (
        narrow > 0.0 and math.sqrt(narrow / len(agree)) >= 2.0 and len(agree) / len(cells) >= share
    )


def levelled_by_loop(points_m, plane, height):
    a, b, d = plane
    length = math.sqrt(1.0 + a * a + b * b)
    nx, ny, nz = -a / length, -b / length, 1.0 / length
    c = 1.0 + nz
    rows = [
        (
            (1.0 - nx * nx / c) * x + (-(nx * ny) / c) * y - nx * z,
            (-(nx * ny) / c) * x + (1.0 - ny * ny / c) * y - ny * z,
            nx * x + ny * y + nz * z + (-d * nz - height),
        )
        for x, y, z in points_m.tolist()
    ]
    return np.array(rows).astype(np.float32)


def generated(seed, noise_m, share=1.0):
    """Return a slope with things on it, on a lattice of 1/64 m: many returns are equally low."""
    rng = np.random.default_rng(seed)
    points_m = rng.uniform([-27, -27, 0], [27, 27, 2], (2500, 3))
    points_m[:1900, 2] = np.abs(rng.normal(0, noise_m, 1900))
    slope_x, slope_y = rng.uniform(-0.12, 0.12, 2)
    points_m[:, 2] += slope_x * points_m[:, 0] + slope_y * points_m[:, 1] - rng.uniform(0.9, 2.3)
    points_m = points_m[np.abs(np.arctan2(points_m[:, 1], points_m[:, 0])) < share * np.pi]
    return (np.round(points_m * 64) / 64).astype(np.float32)


@pytest.mark.parametrize("height_m", [0.05, 0.95, HEIGHT_M, 2.4])
@pytest.mark.parametrize("seed", range(4))
def test_a_scan_is_levelled_as_the_specification_reads_to_the_byte(seed, height_m):
    points_m = generated(seed, noise_m=0.1, share=1.0 if seed % 2 else 0.4)
    points_m[:, 2] *= np.float32(height_m / HEIGHT_M)
    expected = plane_by_loop(points_m, height_m)
    assert expected is not None
    assert ground_plane(points_m, height_m) == GroundPlane(*expected)
    levelled_m = level(Scan(points_m), height_m).points_m
    assert levelled_m.tobytes() == levelled_by_loop(points_m, expected, height_m).tobytes()


def at_a_limit(kind, height_m, rng):
    """Return a few returns of a scan that is around one of the limits."""
    xy = rng.uniform(-22, 22, (160, 2))
    others, lift_m = rng.random(len(xy)), rng.uniform(0.5, 3.0, len(xy))
    slope_x, slope_y, depth_m, noise_m = 0.0, 0.0, height_m, 0.02
    match kind:
        case "cells":
            xy, others, lift_m = (values[: rng.integers(18, 26)] for values in (xy, others, lift_m))
        case "spread":
            xy[:, 1] *= rng.uniform(0.1, 0.3)
        case "slope":
            xy *= 0.5
            slope_x, slope_y = rng.uniform(0.19, 0.24), rng.uniform(-0.08, 0.08)
        case "shallowest":
            depth_m = height_m - 1.5 + rng.uniform(-0.06, 0.06)
        case "deepest":
            depth_m = min(2.2 * height_m, height_m + 1.5) + rng.uniform(-0.06, 0.06)
        case "roughness":
            noise_m = rng.uniform(0.08, 0.25)
        case "height":
            depth_m, noise_m = height_m * rng.uniform(0.75, 0.9), 0.05
        case "bank":
            noise_m = rng.uniform(0.02, 0.2)
    z = slope_x * xy[:, 0] + slope_y * xy[:, 1] - depth_m + rng.normal(0, noise_m, len(xy))
    match kind:
        case "share":
            z += np.where(others < rng.uniform(0.7, 0.95), lift_m, 0.0)
        case "roughness" | "height":
            z += np.where(others < rng.uniform(0.3, 0.95), lift_m, 0.0)
        case "below":
            z -= np.where(others < rng.uniform(0.1, 0.35), lift_m, 0.0)
            z += np.where(others > 0.6, lift_m, 0.0)
        case "bank":
            z += np.maximum(0.0, xy[:, 1] + rng.uniform(-6, 6)) * rng.uniform(0.1, 0.3)
    return np.column_stack([xy, z]).astype(np.float32)


@pytest.mark.parametrize(
    ("kind", "height_m"),
    [
        ("cells", 4.0),
        ("spread", 4.0),
        ("slope", 4.0),
        ("shallowest", 4.0),
        ("deepest", 1.0),
        ("deepest", 4.0),
        ("roughness", 4.0),
        ("height", 4.0),
        ("share", 4.0),
        ("below", 4.0),
        ("bank", 4.0),
    ],
)
def test_at_its_limits_a_plane_is_found_where_the_specification_finds_one(kind, height_m):
    found = set()
    for seed in range(12):
        points_m = at_a_limit(kind, height_m, np.random.default_rng(seed))
        expected = plane_by_loop(points_m, height_m)
        plane = ground_plane(points_m, height_m)
        assert plane == (None if expected is None else GroundPlane(*expected))
        found.add(plane is not None)
    assert found == {False, True}


def test_one_scan_gives_the_numbers_of_the_reference():
    points_m = golden_points()
    assert ground_plane(points_m, HEIGHT_M) == GroundPlane(
        0.04683879853869485, -0.07811547086184606, -1.9704381551721697
    )
    levelled_m = level(Scan(points_m), HEIGHT_M).points_m
    assert levelled_m[0].tolist() == [-22.00726890563965, -21.987876892089844, -0.26620784401893616]
    digest = hashlib.sha256(levelled_m.astype("<f4").tobytes()).hexdigest()
    assert digest == "8407cac1e37b68d8756ea1a9dc3ea69ec2eea5aa61890e58994c2364b12f58dd"


def golden_points():
    """Return 2025 returns of a lattice, whose numbers are whole multiples of 1/64 m."""
    i, j = (values.ravel() for values in np.meshgrid(range(-22, 23), range(-22, 23), indexing="ij"))
    z = 3 * i - 5 * j + (i * 7 + j * 13) % 4 + np.where((i * i + 3 * j) % 11 == 0, 96, 0) - 128
    return np.stack([i, j, z / 64], axis=1).astype(np.float32)
