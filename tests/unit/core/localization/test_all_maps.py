"""One query in several maps."""

import itertools
import weakref
from dataclasses import replace

import pytest

from core.confidence.calibration import Calibration
from core.confidence.decision import Refusal
from core.errors import InvalidParameters
from core.localization import all_maps
from core.localization.all_maps import SearchedMap, localize_in_maps
from core.localization.localizer import Localizer
from tests.support.samples import (
    calibrated_map,
    own_signatures,
    sample_harmonic_map,
    sample_map,
)


def searched(name, tensor_map, query, row):
    return SearchedMap(name, tensor_map, tensor_map.model.search(own_signatures(query, row)))


def test_the_map_of_the_nearest_scan_is_the_answer_and_the_others_follow():
    north, south = (sample_map(seed=seed)[0] for seed in (1, 2))
    for query, slug in ((north, "north"), (south, "south")):
        found = localize_in_maps(
            [searched("north", north, query, 5), searched("south", south, query, 5)], 3
        )
        assert (found.best.name, found.best.match.row) == (slug, 5)
        assert found.best.revision == query.revision
        distances = [one.match.distance for one in found.matches]
        assert len(distances) == 3
        assert distances == sorted(distances)
        assert found.ratio == 0.0


def test_in_one_map_the_answer_is_that_of_the_map():
    tensor_map = calibrated_map()
    alone = Localizer(tensor_map).localize_signatures(own_signatures(tensor_map, 31))
    found = localize_in_maps([searched("one", tensor_map, tensor_map, 31)])
    assert found.best.match == alone.best
    assert found.decision == alone.decision
    assert found.runner_up is not None
    assert found.runner_up.match == alone.runner_up
    assert found.deviation == alone.deviation


def test_the_runner_up_of_another_map_lowers_the_probability():
    tensor_map = calibrated_map()
    [one] = [searched("one", tensor_map, tensor_map, 31)]
    alone = localize_in_maps([one])
    twice = localize_in_maps([one, searched("copy", tensor_map, tensor_map, 31)])
    assert twice.runner_up is not None
    assert (twice.best.name, twice.runner_up.name) == ("one", "copy")
    assert twice.ratio == 1.0
    assert (twice.decision.probability or 1.0) < (alone.decision.probability or 0.0)


def test_a_runner_up_of_many_places_says_less_than_one_of_few():
    one, other = (calibrated_map(seed=seed) for seed in (1, 2))
    mixed = [
        replace(near, values=0.6 * near.values + 0.4 * far.values)
        for near, far in zip(own_signatures(one, 90), own_signatures(other, 90), strict=True)
    ]
    maps = {"one": one, "other": other}
    alone = Localizer(one).localize_signatures(mixed)
    found = [
        localize_in_maps(
            [SearchedMap(name, of, of.model.search(mixed)) for name, of in maps.items()],
            other_places=places,
        )
        for places in (0, 10**3, 10**6)
    ]
    assert [answer.best.name for answer in found] == ["one"] * 3
    # Among a million places its own one says more against it, and as much as in the map alone.
    assert [answer.runner_up and answer.runner_up.name for answer in found] == [
        "other",
        "other",
        "one",
    ]
    assert found[0].ratio == found[1].ratio
    few, many, most = (answer.decision.probability or 0.0 for answer in found)
    assert few < many < most == alone.decision.probability


def test_maps_of_several_measures_are_compared_by_their_calibrations():
    paper, (harmonic, _) = calibrated_map(), sample_harmonic_map()
    found = localize_in_maps(
        [searched("harmonic", harmonic, harmonic, 5), searched("paper", paper, paper, 31)]
    )
    assert found.best.name == "paper"  # the other is not calibrated
    alone = localize_in_maps([searched("paper", paper, paper, 31)])
    assert found.ratio == alone.ratio


def test_a_map_of_another_measure_changes_nothing_between_the_others():
    trust = Calibration(0.001, (4.0, 0.0, -8.0), (4.0, 0.0), (4.0, -1.0))
    one, (elsewhere, _) = replace(calibrated_map(), calibration=trust), sample_harmonic_map()
    twins = [searched(name, one, one, 31) for name in ("one", "copy")]
    # In the harmonic map that is calibrated such a scan is likelier than all but the twins'.
    likely = replace(elsewhere, calibration=Calibration(0.001, (0, 0, 0), (0, 0), (8.0, 0.0)))
    alike = localize_in_maps([*twins, searched("far", calibrated_map(seed=1), one, 31)])
    assert alike.decision.reason is Refusal.AMBIGUOUS
    for other in (elsewhere, likely):
        maps = [*twins, searched("harmonic", other, other, 5)]
        maps.append(searched("far", calibrated_map(seed=1), one, 31))
        for order in itertools.permutations(maps):
            mixed = localize_in_maps(order)
            assert {mixed.best.name, mixed.runner_up and mixed.runner_up.name} == {"one", "copy"}
            assert mixed.ratio == alike.ratio == 1.0
            assert mixed.decision.reason is Refusal.AMBIGUOUS


def test_a_map_without_calibration_keeps_its_place_before_maps_that_have_one():
    paper, (likely, _) = calibrated_map(), sample_harmonic_map()
    far = replace(likely, calibration=Calibration(0.001, (0, 0, 0), (0, 0), (-50.0, 0.0)))
    small = replace(paper, calibration=None)
    maps = [searched("small", small, paper, 31), searched("far", calibrated_map(seed=1), paper, 31)]
    assert localize_in_maps(maps).best.name == "small"
    maps.append(searched("harmonic", far, far, 5))
    assert [localize_in_maps(order).best.name for order in itertools.permutations(maps)] == [
        "small"
    ] * 6
    # Nor does another such map hide the one by which both have their place.
    maps.append(searched("twin", small, paper, 31))
    best = {localize_in_maps(order).best.name for order in itertools.permutations(maps)}
    assert best == {"small", "twin"}


def test_the_answer_of_uncalibrated_maps_of_several_measures_does_not_depend_on_their_order():
    (paper, _), (harmonic, _) = sample_map(), sample_harmonic_map()
    assert paper.calibration is harmonic.calibration is None
    one, other = searched("a", paper, paper, 3), searched("b", harmonic, harmonic, 3)
    found = [localize_in_maps(maps, 4) for maps in ([one, other], [other, one])]
    assert found[0].best == found[1].best
    assert [match.name for match in found[0].matches] == [match.name for match in found[1].matches]


def test_a_map_that_cannot_be_in_the_answer_is_not_kept():
    alive: weakref.WeakSet[object] = weakref.WeakSet()
    query = own_signatures(sample_map(seed=3)[0], 5)

    def searching(seeds):
        for seed in seeds:
            tensor_map, _ = sample_map(seed=seed)
            alive.add(tensor_map)
            assert len(alive) <= 8
            yield SearchedMap(f"map {seed}", tensor_map, tensor_map.model.search(query))
            del tensor_map

    seeds = range(1, 21)
    rising, falling = (localize_in_maps(searching(order), 2) for order in (seeds, seeds[::-1]))
    assert rising.best.name == "map 3"
    for name in ("matches", "runner_up", "decision", "ratio"):
        assert getattr(rising, name) == getattr(falling, name)
    listed = [
        distance
        for seed in seeds
        for distance in sample_map(seed=seed)[0].model.search(query).nearest(2).distances
    ]
    assert [one.match.distance for one in rising.matches] == sorted(listed)[:2]


def test_a_query_of_too_few_cells_is_refused_as_by_the_map_alone():
    tensor_map = calibrated_map()
    assert tensor_map.calibration is not None
    least = tensor_map.calibration.least_cells
    found = [
        localize_in_maps([replace(searched("one", tensor_map, tensor_map, 31), occupied_cells=n)])
        for n in (least, least - 1)
    ]
    reasons = [one.decision.reason for one in found]
    assert reasons == [None, Refusal.TOO_FEW_RETURNS]


def test_without_a_map_there_is_no_answer():
    with pytest.raises(InvalidParameters, match="no map"):
        localize_in_maps([])


def test_a_map_that_explains_the_query_between_its_scans_is_preferred(monkeypatch):
    tensor_map, _ = sample_harmonic_map()
    other, _ = sample_harmonic_map(seed=2)
    query = tensor_map.model.recorded[5] + 0.3 * tensor_map.model.recorded[6]
    maps = {"one": tensor_map, "other": other}
    searches = [
        SearchedMap(name, one, one.model.search_values(query)) for name, one in maps.items()
    ]
    distances = [float(one.search.nearest(1).distances[0]) for one in searches]
    nearest = int(distances[1] < distances[0])
    far = distances[1 - nearest] / distances[nearest]
    shares = {id(one.search): 1.0 for one in searches}
    shares[id(searches[1 - nearest].search)] = 0.5 / far
    monkeypatch.setattr(all_maps, "share_left", lambda search, *_: shares[id(search)])
    found = localize_in_maps(searches)
    assert found.best.name == searches[1 - nearest].name
    assert found.best.match.distance == distances[1 - nearest]
    alone = localize_in_maps([searches[1 - nearest]])
    assert found.ratio == pytest.approx(max(0.5, alone.ratio or 0.0))
