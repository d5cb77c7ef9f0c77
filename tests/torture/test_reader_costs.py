"""What the worst bodies cost that a search found: 5 s of CPU and 500 MB at most.

Every row is measured in a process of its own. The table is kept in
docs/reference/service-measurements.md.
"""

import json
import subprocess
import sys
from typing import Any

import pytest

from tests.torture import worst_requests
from tests.torture.worst_bodies import ARCHIVES, REFUSED, SINGLE, TWINS, UNPACKED

pytestmark = [pytest.mark.torture, pytest.mark.alone]

MOST_CPU_S, MOST_MB = 5.0, 500
MOST_TIMES_A_WELL_FORMED_ONE = 3.0
ARCHIVE_BYTES = 32 * 2**20


def cost_of(kind: str, name: str, size: int) -> dict[str, Any]:
    """Make a body and read it; return its bytes, CPU seconds, megabytes and outcome."""
    return _measured("tests.torture.worst_bodies", kind, name, str(size))


def cost_over_http(name: str) -> dict[str, Any]:
    """Send a body to a service; return the same, of all that the service does."""
    return _measured("tests.torture.worst_requests", name)


def _measured(module: str, *words: str) -> dict[str, Any]:
    name = words[-1] if len(words) == 1 else words[1]
    done = subprocess.run(
        [sys.executable, "-m", module, *words],
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )
    costs: dict[str, Any] = json.loads(done.stdout)
    print(
        f"| {name} | {costs['bytes'] / 2**20:.1f} | {costs['cpu_s']:.2f} | {costs['mb']}"
        f" | {costs['outcome']} |"
    )
    return costs


@pytest.mark.parametrize("name", SINGLE)
def test_the_worst_single_body_is_within_the_budget(name: str) -> None:
    costs = cost_of("single", name, UNPACKED)
    error, refused, _ = costs["outcome"].partition(": ")  # what is refused at once costs nothing
    assert (error if refused else "") == REFUSED.get(name, ""), costs
    assert costs["cpu_s"] <= MOST_CPU_S, costs
    assert costs["mb"] <= MOST_MB, costs


@pytest.mark.parametrize("name", ARCHIVES)
def test_a_byte_of_the_worst_archive_costs_what_three_of_a_well_formed_one_do(name: str) -> None:
    twin = ARCHIVES[name][2]
    assert twin in TWINS
    good = cost_of("twin", twin, ARCHIVE_BYTES)
    bad = cost_of("archive", name, ARCHIVE_BYTES)
    assert bad["mb"] <= MOST_MB, bad
    most_s = MOST_TIMES_A_WELL_FORMED_ONE * good["cpu_s"] * bad["bytes"] / good["bytes"]
    assert bad["cpu_s"] <= max(most_s, 0.2), (bad, good)


@pytest.mark.parametrize("name", worst_requests.REQUESTS)
def test_poses_are_read_compared_and_stored_within_the_budget(name: str) -> None:
    costs = cost_over_http(name)
    assert costs["outcome"] == worst_requests.REFUSED.get(name, "200"), costs
    assert costs["cpu_s"] <= MOST_CPU_S, costs
    assert costs["mb"] <= MOST_MB, costs


@pytest.mark.parametrize("name", worst_requests.ARCHIVES)
def test_files_that_are_refused_cost_what_three_scans_of_their_size_do(name: str) -> None:
    _, twin, outcome = worst_requests.ARCHIVES[name]
    bad = cost_over_http(name)
    assert bad["outcome"] == outcome, bad
    assert bad["mb"] <= MOST_MB, bad
    if twin:
        good = cost_over_http(twin)
        most_s = MOST_TIMES_A_WELL_FORMED_ONE * good["cpu_s"] * bad["bytes"] / good["bytes"]
        assert bad["cpu_s"] <= most_s, (bad, good)
