"""Codes of places."""

import numpy as np

from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.place_code import PlaceCode, features
from tests.support.samples import sample_harmonic_map


def harmonic_model():
    model = sample_harmonic_map(48)[0].model
    assert isinstance(model, HarmonicModel)
    return model


def signatures(count, seed=0):
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(count, 4, 5)) + 1j * rng.normal(size=(count, 4, 5))
    found.imag[..., 0] = 0.0
    return found


def test_features_do_not_depend_on_heading_or_scale():
    found = signatures(20)
    turned = 3.0 * found * np.exp(1j * np.arange(5) * 0.7)
    assert np.allclose(features(found, 4, 5), features(turned, 4, 5), atol=1e-6)
    assert not np.allclose(features(found[:1], 4, 5), features(found[1:2], 4, 5), atol=1e-2)


def test_a_place_and_its_query_have_codes_within_rounding():
    model = harmonic_model()
    code = PlaceCode.train([model], 1000)
    stored = code.of(model.signatures[:, 1])
    assert stored.dtype == np.int8
    clipped = np.clip(code.of_query(model.signatures[7, 1]), -127, 127)
    assert np.abs(clipped - stored[7]).max() <= 0.5 + 1e-3
    away = np.abs(stored.astype(int) - stored[7]).sum(axis=1)
    assert away[np.arange(48) != 7].min() > 0


def test_a_query_of_fewer_numbers_has_a_code():
    model = harmonic_model()
    code = PlaceCode.train([model], 1000)
    assert np.isfinite(code.of_query(model.signatures[0, 1, :2, :2])).all()


def test_every_code_is_in_its_nearest_list():
    model = harmonic_model()
    code = PlaceCode.train([model], 10_000)
    codes = code.of(model.signatures[:, 1])
    far = np.square(codes[:, None].astype(float) - code.centres).sum(axis=2)
    assert len(code.centres) > 1
    assert (far[np.arange(48), code.lists_of(codes)] <= far.min(axis=1) + 1e-2).all()
