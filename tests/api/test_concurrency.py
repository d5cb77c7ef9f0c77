"""Many clients at once: nothing is lost, stored twice or answered from two maps."""

import threading
from concurrent.futures import ThreadPoolExecutor

from core.encodings.signature import pack_signatures
from tests.support.campus import basis_of
from tests.support.recording import KITTI, kitti, recording, upload_scan

PACKED = {"Content-Type": "application/vnd.tensormap.signature"}


def test_eight_clients_that_put_the_same_scans_store_each_once(empty):
    drive = recording(scans=48)
    puts = [*range(40), *range(40)]

    def put(index):
        response = upload_scan(empty, "campus", "monday", index, drive.scans[index])
        return response.status_code, response.json()["digest"]

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(put, puts))
    assert sorted(status for status, _ in answers) == [200] * 40 + [201] * 40
    assert [digest for _, digest in answers[:40]] == [digest for _, digest in answers[40:]]
    shown = empty.get("/v1/maps/campus/drives/monday").json()
    assert (shown["scans"], shown["present"]) == (40, [{"first": 0, "last": 39}])
    files = list(empty.service.settings.data_dir.rglob("chunks/*"))
    assert len(files) == 40  # those that lost a race left none


def test_while_live_changes_every_answer_is_of_one_revision(own, built):
    scan = kitti(recording(noise_seed=7, scans=6).scans[4])

    def by_scan():
        return own.post("/v1/maps/campus/localizations/scan", content=scan, headers=KITTI)

    def by_signature(signature):
        return own.post(
            "/v1/maps/campus/localizations/signature", content=signature, headers=PACKED
        )

    alone, signatures = {}, {}
    for revision in (built.other, built.live):
        own.put("/v1/maps/campus/live", json={"revision": revision})
        basis = basis_of(own)
        image = basis.image(recording(noise_seed=7, scans=6).scans[4])
        signatures[revision] = pack_signatures(basis.encode(image))
        alone["scan", revision] = by_scan().json()["matches"]
        alone["signature", revision] = by_signature(signatures[revision]).json()["matches"]

    done = threading.Event()

    def keep_querying(number):
        answers = []
        while not done.is_set():
            answers.append(("scan", None, by_scan()))
            expected = (built.live, built.other)[(number + len(answers)) % 2]
            answers.append(("signature", expected, by_signature(signatures[expected])))
        return answers

    with ThreadPoolExecutor(4) as pool:
        querying = [pool.submit(keep_querying, number) for number in range(4)]
        for switch in range(40):
            revision = (built.other, built.live)[switch % 2]
            switched = own.put("/v1/maps/campus/live", json={"revision": revision})
            assert switched.json()["live_revision"] == revision
        done.set()
        answers = [answer for client in querying for answer in client.result()]
    for kind, expected, response in answers:
        assert response.status_code == 200, response.text
        answer = response.json()
        assert answer["revision"] in {built.live, built.other}
        assert answer["live_revision"] in {built.live, built.other}
        assert expected in {None, answer["revision"]}
        if kind == "scan":
            assert answer["revision"] == answer["live_revision"]
        assert answer["matches"] == alone[kind, answer["revision"]]
    assert {response.json()["revision"] for kind, _, response in answers if kind == "scan"} == {
        built.live,
        built.other,
    }
