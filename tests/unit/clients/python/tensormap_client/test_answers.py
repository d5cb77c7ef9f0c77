import dataclasses
import json

import pytest
from tensormap_client import Localization, LocalizationInMaps, TrackAnswer, Unreachable
from tensormap_client.answers import JsonObject

MATCH = {"segment": 0, "fraction": 0.5, "drive": "monday", "scan_index": 3, "distance": 0.1}
MATCH |= {"pose": None, "estimated_pose": None, "map": "campus", "revision": "1f"}
FOUND = {"revision": "1f", "live_revision": "1f", "map": "campus", "localized": True}
FOUND |= {"best": MATCH, "matches": [MATCH], "pose": None, "of a newer service": 1}


@pytest.mark.parametrize("kind", [Localization, LocalizationInMaps, TrackAnswer])
def test_an_answer_becomes_a_dictionary_and_its_raw_form_is_one(kind) -> None:
    found = kind.from_json(JsonObject("POST /v1", FOUND))
    assert json.loads(json.dumps(dataclasses.asdict(found)))["raw"] == FOUND
    assert found.raw["of a newer service"] == 1
    with pytest.raises(KeyError, match="of a later one"):
        found.raw["of a later one"]


@pytest.mark.parametrize("kind", [Localization, LocalizationInMaps])
def test_a_match_without_a_field_of_this_client_is_named_with_its_request(kind) -> None:
    of_earlier = {name: value for name, value in MATCH.items() if name != "estimated_pose"}
    answer = JsonObject("POST http://maps.example/v1", FOUND | {"best": of_earlier})
    with pytest.raises(Unreachable, match=r"POST http://maps.* without 'estimated_pose'"):
        kind.from_json(answer)
