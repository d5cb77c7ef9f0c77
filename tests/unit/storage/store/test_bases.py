"""Shared bases in the store."""

from tests.support.samples import sample_harmonic_map


def test_a_file_that_replaces_a_damaged_one_is_synced_in_its_place(store, monkeypatch):
    basis = sample_harmonic_map()[0].basis()
    record, _ = store.bases.add("city", basis)
    path = store.layout.bases / record.file_name
    whole = path.read_bytes()
    path.write_bytes(b"damaged")
    synced = []
    monkeypatch.setattr(
        "storage.store.bases.sync", lambda folder: synced.append((folder, path.read_bytes()))
    )
    assert store.bases.add("city", basis) == (record, False)
    assert synced == [(path.parent, whole)]
