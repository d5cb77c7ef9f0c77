"""Queries that name no map, and the maps that they search."""

import tempfile
from dataclasses import replace
from pathlib import Path

from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from storage.files.map_file import map_of_bytes, write_map
from tests.support.process import until


def shared_basis(client, name="city", **options):
    return BasisOut.model_validate(client.get(f"/v1/bases/{name}", **options).json()).to_core()


def packed(basis, scan):
    return pack_signatures(basis.encode(basis.image(scan)))


def ask(client, kind, content, headers, **options):
    return client.post(f"/v1/localizations/{kind}", content=content, headers=headers, **options)


def import_again(client, source, slug, **parameters):
    """Import the live revision of a map into another one, with other parameters."""
    live = client.get(f"/v1/maps/{source}").json()["live_revision"]
    file = client.get(f"/v1/maps/{source}/revisions/{live}/file").content
    if parameters:
        found = map_of_bytes(file, source)
        changed = replace(found, parameters=replace(found.parameters, **parameters))
        with tempfile.TemporaryDirectory() as folder:
            write_map(Path(folder) / "map.h5", changed)
            file = (Path(folder) / "map.h5").read_bytes()
    client.post("/v1/maps", json={"map": slug})
    media_type = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
    imported = client.post(f"/v1/maps/{slug}/revisions", content=file, headers=media_type)
    assert imported.status_code == 201, imported.text


def index_maps(client, monkeypatch):
    monkeypatch.setattr("app.localization.all_maps.FEWEST_MAPS", 2)
    monkeypatch.setattr("app.localization.place_indexes.FEWEST_MAPS", 2)
    digest = client.get("/v1/bases/city").json()["basis"]
    indexes = client.service.indexes

    def is_open():
        # An update that began with the service, for which two maps were few, may remove it once.
        indexes.update(digest)
        return indexes.open(digest) is not None

    until(is_open, "the maps are not indexed")
