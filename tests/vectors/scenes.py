"""The scans of the conformance kit: small, seeded, each of some cases."""

from collections.abc import Iterator

import numpy as np

from core.arrays import Float32Array, FloatArray

SENSOR_HEIGHT_M = 1.73
_LOWEST_DEG, _HIGHEST_DEG = -24.0, 6.0
_LIMITS = 70


def kit_scans() -> dict[str, Float32Array]:
    """Return `(n, 3)` rows of each file, as a sensor writes them: also rows that are no returns."""
    street_m = street(1, beams=10, firings=180)
    scans = {
        "street": street_m,
        "tilted": rotated(street_m, roll_deg=4.0, pitch_deg=-3.0) - [0.0, 0.0, 0.12],
        "pitched": rotated(street_m[::2], roll_deg=-6.0, pitch_deg=11.0),
        "narrow": within(street(2, beams=12, firings=220), 55.0),
        "near": street(3, beams=10, firings=150, reach_m=27.0),
        "middle": street(7, beams=10, firings=150, reach_m=35.0),
        "tunnel": tunnel(),
        "far": far(),
        "lattice": lattice(),
        "odd": odd(street(5, beams=8, firings=120)),
        "ties": ties(),
        "sectors": sectors([s % 7 for s in range(60)]),
        "ten": sectors([4 if s % 6 == 0 else 2 for s in range(60)]),
        "nine": sectors([4 if s > 0 and s % 6 == 0 else 2 * (s % 6 != 5) for s in range(60)]),
        "forty": sectors([6 if s < 40 else 1 for s in range(60)]),
        "beyond": np.concatenate([street_m[::4], [[3e38, 3e38, -1e37], [-2e38, 1.0, 0.5]]]),
        "high": np.concatenate([street_m[::4], [[10.25, -3.5, 1e31]]]),
        "one": np.array([[7.25, -3.5, 1.0]]),
        "ground": street_m[street_m[:, 2] < -1.6],
        "nothing": np.array([[np.nan, 1.0, 1.0], [0.0, -0.0, 0.0], [np.inf, 0.0, 1.0]]),
    }
    with np.errstate(over="ignore"):
        return {name: points_m.astype(np.float32) for name, points_m in scans.items()}


def street(seed: int, *, beams: int, firings: int, reach_m: float = 79.0) -> FloatArray:
    """Return a street between walls of many heights, on rough ground with things on it."""
    rng = np.random.default_rng(seed)
    elevation_deg, azimuth_deg = np.meshgrid(
        np.linspace(_LOWEST_DEG, _HIGHEST_DEG, beams), np.arange(firings) * 360.0 / firings
    )
    azimuth = np.radians(azimuth_deg.ravel() + rng.uniform(-0.4, 0.4, azimuth_deg.size))
    elevation = np.radians(elevation_deg.ravel())
    wall_m = 7.0 + 20.0 * np.abs(np.sin(1.5 * azimuth + seed)) + 9.0 * np.cos(7.0 * azimuth) ** 2
    wall_m *= np.where(np.sin(3.0 * azimuth) > 0.8, 2.2, 1.0)
    range_m = wall_m / np.cos(elevation)
    down = elevation < 0.0
    range_m[down] = np.minimum(range_m[down], SENSOR_HEIGHT_M / np.sin(-elevation[down]))
    things = rng.random(range_m.size) < 0.1
    range_m[things] *= rng.uniform(0.5, 0.9, np.count_nonzero(things))
    range_m += rng.normal(0.0, 0.02, range_m.size)
    across_m = range_m * np.cos(elevation)
    points_m = np.stack(
        [across_m * np.cos(azimuth), across_m * np.sin(azimuth), range_m * np.sin(elevation)], 1
    )
    return points_m[across_m < reach_m]


def rotated(points_m: FloatArray, *, roll_deg: float, pitch_deg: float) -> FloatArray:
    """Return returns as a sensor sees them whose axes are rolled, then pitched."""
    roll, pitch = np.radians([roll_deg, pitch_deg])
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    )
    about_y = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    rotation: FloatArray = about_y @ about_x
    return np.asarray(points_m @ rotation)  # of rows: the inverse


def within(points_m: FloatArray, half_deg: float) -> FloatArray:
    """Return what a sensor sees whose view ends that far to the left and to the right."""
    return points_m[np.abs(np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))) < half_deg]


def tunnel() -> FloatArray:
    """Return walls nearer than 6 m on all sides but one, with gaps."""
    points_m = street(4, beams=10, firings=120)
    across_m = np.hypot(points_m[:, 0], points_m[:, 1])
    azimuth_deg = np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))
    nearer = np.where(np.abs(azimuth_deg) < 15.0, 1.0, np.minimum(1.0, 5.4 / across_m))
    points_m[:, :2] *= nearer[:, None]
    return points_m[np.abs(np.abs(azimuth_deg) - 100.0) > 9.0]


def sectors(far_columns: list[int]) -> FloatArray:
    """Return walls in 12 rings of 4 m, in so many columns of each sector, the others being near."""
    rows = []
    for sector, count in enumerate(far_columns):
        for column in range(6):
            azimuth = np.radians(6.0 * sector + column)
            across_m = 9.0 + (7 * sector + 3 * column) % 40 if column < count else 5.95
            direction = np.array([np.cos(azimuth), np.sin(azimuth)])
            if (sector, column) in ((15, 0), (45, 0)):  # on the edge: 6 m exactly
                across_m, direction = 6.0, np.array([0.0, 1.0 if sector == 15 else -1.0])
            rows.append([*(across_m * direction), 0.25 * (sector % 9)])
    return np.array(rows)


def limits() -> Iterator[tuple[FloatArray, float]]:
    """Yield returns around the limits of a plane of the ground, and the height of the sensor.

    On a lattice of 1/16 m: many are equally low.
    """
    for seed in range(_LIMITS):
        rng = np.random.default_rng(seed)
        kind, height_m = seed % 10, float(rng.choice([0.75, 1.0, 1.75, 4.0]))
        xy = rng.uniform(-23, 23, (90, 2))
        slope, depth_m, noise_m = np.zeros(2), height_m * rng.uniform(0.8, 1.1), 0.02
        lifted, lift_m = rng.random(90) < 0.1, rng.uniform(0.5, 2.0, 90)
        if kind == 0:
            depth_m, slope = height_m, np.array([rng.uniform(0.2, 0.235), rng.uniform(-0.03, 0.03)])
            xy, lifted = 0.6 * xy, lifted & False
        elif kind == 1:
            xy[:, 1] *= rng.uniform(0.1, 0.3)
        elif kind == 2:
            depth_m = max(0.4 * height_m, height_m - 1.5) + rng.uniform(-0.06, 0.06)
        elif kind == 3:
            depth_m = min(2.2 * height_m, height_m + 1.5) + rng.uniform(-0.06, 0.06)
        elif kind == 4:
            lifted, noise_m = rng.random(90) < rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.15)
        elif kind == 5:
            lifted, lift_m = rng.random(90) < rng.uniform(0.1, 0.5), -lift_m
        elif kind == 6:
            depth_m, lifted = height_m * rng.uniform(0.7, 0.9), rng.random(90) < 0.6
        elif kind == 7:  # two layers, of which either may win
            height_m = depth_m = 2.0
            lifted = np.arange(90) < rng.integers(22, 30)
            lift_m = np.full(90, -rng.uniform(0.1, 0.6))
            xy = xy[: 88 - int(rng.integers(0, 8))]
            lifted, lift_m = lifted[: len(xy)], lift_m[: len(xy)]
        elif kind == 8:  # a valley: of two slopes the first wins, of two equally low returns too
            height_m = depth_m = 2.0
            xy[45:] = xy[:45] * [-1.0, 1.0]
            lifted, lift_m, noise_m = np.ones(90, bool), 0.1 * np.abs(xy[:, 0]), 0.0
            xy[1::9, 1] = xy[::9, 1] + 0.5
            xy[1::9, 0] = xy[::9, 0]
        else:
            slope, noise_m = rng.uniform(-0.12, 0.12, 2), rng.uniform(0.05, 0.3)
        z = xy @ slope - depth_m + rng.normal(0, noise_m, len(xy)) + np.where(lifted, lift_m, 0.0)
        yield np.rint(16.0 * np.column_stack([xy, z])) / 16.0, height_m


def far() -> FloatArray:
    """Return a street before mountains, kilometres away: numbers beyond float16."""
    rng = np.random.default_rng(6)
    azimuth = np.radians(np.arange(0.0, 360.0, 0.9))
    parts = []
    for elevation_deg, farthest_m in ((-14.0, 9.0), (-8.0, 20.0), (-3.0, 40.0), (2.0, 3e4)):
        range_m = farthest_m * rng.uniform(0.5, 1.0, azimuth.size)
        elevation = np.radians(elevation_deg)
        across_m = range_m * np.cos(elevation)
        up_m = range_m * np.sin(elevation)
        parts.append(np.stack([across_m * np.cos(azimuth), across_m * np.sin(azimuth), up_m], 1))
    return np.concatenate(parts)


def lattice() -> FloatArray:
    """Return the golden scan of levelling (docs/reference/signature.md): many are equally low."""
    i, j = (axis.ravel() for axis in np.meshgrid(range(-22, 23), range(-22, 23), indexing="ij"))
    z = 3 * i - 5 * j + (i * 7 + j * 13) % 4 + np.where((i * i + 3 * j) % 11 == 0, 96, 0) - 128
    return np.stack([i, j, z / 64], axis=1)


def odd(points_m: FloatArray) -> FloatArray:
    """Return a scan with rows that are no returns, or are where no cell is."""
    rows = [
        [np.nan, np.nan, np.nan],
        [5.0, np.nan, 1.0],
        [np.inf, 1.0, 1.0],
        [1.0, 1.0, -np.inf],
        [0.0, 0.0, 0.0],
        [-0.0, 0.0, -0.0],
        [1e39, 9.0, 1.0],  # infinite in float32
        [0.0, 0.0, 5.0],  # straight up
        [0.0, 0.0, -1.2],  # straight down
        [1e-42, 0.0, 0.5],  # subnormal in float32
        [3e5, 4e5, 1e9],
        [250.0, -90.0, 12.0],
        [-80.0, 1e-30, 3.0],
        [-1e-30, 7.0, -1.8],  # lowest of a cell that ends at 0
    ]
    every = len(points_m) // len(rows)
    return np.insert(points_m, np.arange(len(rows)) * every, rows, axis=0)


def ties() -> FloatArray:
    """Return returns in the middle between two cells, on the edges of rings and of sectors."""
    rows = []
    for number, (x, y) in enumerate([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (1, -1)]):
        for across in (4.0, 5.5, 6.0, 7.0, 12.0, 40.0, 60.0, 80.0):
            z = 0.25 * number - 0.01 * across
            rows.append([x * across, y * across, z])
            rows.append([x * across, y * across, 0.0])  # at elevation 0, between two odd rows
            rows.append([x * across, -0.0 if y == 0 else y * across, z + 1.5])
            rows.append([x * across, y * across, np.hypot(x, y) * across])  # at 45 degrees
    rows += [[12.0, 16.0, 2.0], [-48.0, 64.0, 9.0], [-12.0, -16.0, 2.5], [3.0, -4.0, 1.25]]
    rows += [[0.0, -8.0, -1.73], [0.0, -8.0, -1.0], [-0.0, -20.0, 0.5]]
    rng = np.random.default_rng(8)
    return np.concatenate([rows, rng.uniform([-60, -60, -1.5], [60, 60, 6], (150, 3))])
