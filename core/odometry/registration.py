"""Registration of scans to a map of points by KISS-ICP (Vizzo et al., RA-L 2023), one thread.

KISS-ICP is imported when a drive is registered and not before: no answer of the service needs it.
"""

from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from core.arrays import FloatArray
from core.scans.rigid import exact

LIBRARY = "kiss-icp"


@dataclass(frozen=True)
class RegistrationParameters:
    """The parameters of KISS-ICP, its own defaults but for the cut of near returns.

    Attributes:
        max_range_m: Farther returns are left out.
        min_range_m: Nearer ones too: they are the vehicle's own.
        voxel_m: Side of the cells of the map.
        points_per_voxel: Most that a cell of the map keeps.
        iterations: Most of one registration.
        convergence: Smallest step of one that has not converged.
        initial_threshold_m: The first deviation from constant velocity that is expected.
        min_motion_m: Smaller deviations do not change the expectation.
    """

    max_range_m: float = 100.0
    min_range_m: float = 2.0
    voxel_m: float = 1.0
    points_per_voxel: int = 20
    iterations: int = 500
    convergence: float = 1e-4
    initial_threshold_m: float = 2.0
    min_motion_m: float = 0.1

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


def library_version() -> str | None:
    """Return the version of KISS-ICP, `None` if it is not installed."""
    try:
        return version(LIBRARY)
    except PackageNotFoundError:
        return None


class Registration:
    """A map of points, and scans that are registered to it.

    Args:
        parameters: The parameters of KISS-ICP.
    """

    def __init__(self, parameters: RegistrationParameters) -> None:
        from kiss_icp.config.config import (  # only drives without poses need it
            AdaptiveThresholdConfig,
            DataConfig,
            MappingConfig,
            RegistrationConfig,
        )
        from kiss_icp.config.parser import KISSConfig
        from kiss_icp.mapping import get_voxel_hash_map
        from kiss_icp.preprocess import get_preprocessor
        from kiss_icp.registration import get_registration
        from kiss_icp.threshold import get_threshold_estimator

        # All are given, because what is not would be read from the environment.
        config = KISSConfig(
            out_dir="",
            data=DataConfig(
                max_range=parameters.max_range_m, min_range=parameters.min_range_m, deskew=False
            ),
            mapping=MappingConfig(
                voxel_size=parameters.voxel_m, max_points_per_voxel=parameters.points_per_voxel
            ),
            registration=RegistrationConfig(
                max_num_iterations=parameters.iterations,
                convergence_criterion=parameters.convergence,
                max_num_threads=1,  # sums of several threads differ from run to run
            ),
            adaptive_threshold=AdaptiveThresholdConfig(
                fixed_threshold=None,
                initial_threshold=parameters.initial_threshold_m,
                min_motion_th=parameters.min_motion_m,
            ),
        )
        self._parameters = parameters
        self._map = get_voxel_hash_map(config)
        self._preprocessor = get_preprocessor(config)
        self._registration = get_registration(config)
        self._threshold = get_threshold_estimator(config)

    @property
    def sigma_m(self) -> float:
        """The deviation from the motion model that is expected now."""
        return float(self._threshold.get_threshold())

    def thinned(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return returns within range in half a voxel each, and fewer of them to be registered."""
        from kiss_icp.voxelization import voxel_down_sample

        in_range = self._preprocessor.preprocess(points_m, np.empty(0), np.eye(4))
        dense = voxel_down_sample(in_range, 0.5 * self._parameters.voxel_m)
        return dense, voxel_down_sample(dense, 1.5 * self._parameters.voxel_m)

    def aligned(self, points_m: FloatArray, guess: FloatArray, sigma_m: float) -> FloatArray:
        """Return the pose of a scan in the map, `(4, 4)`; the guess if there is none.

        Args:
            points_m: `(n, 3)` thinned returns of the scan.
            guess: About where it was taken, `(4, 4)`.
            sigma_m: How far the guess may be off; matches up to three times as far apart count.
        """
        found: FloatArray = self._registration.align_points_to_map(
            points=points_m,
            voxel_map=self._map,
            initial_guess=exact(guess),
            max_correspondance_distance=3.0 * sigma_m,
            kernel=sigma_m,
        )
        return exact(found) if np.isfinite(found).all() else guess

    def add(self, points_m: FloatArray, pose: FloatArray, deviation: FloatArray) -> None:
        """Add thinned returns that were registered; forget what is out of range by now.

        Args:
            points_m: `(n, 3)` in the scan's frame.
            pose: The scan's pose, `(4, 4)`.
            deviation: The deviation from the pose that was expected, `(4, 4)`.
        """
        self._threshold.update_model_deviation(exact(deviation))
        self._map.update(points_m, exact(pose))
