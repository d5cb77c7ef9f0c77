"""The ETag of a basis."""

from dataclasses import replace

from app.revisions.basis_answers import basis_tag
from core.parameters import MapParameters, Segmentation
from core.projection.imager import Views
from tests.support.samples import sample_harmonic_map


def test_a_basis_is_another_to_vehicles_with_other_parameters_of_signatures_only():
    parameters = replace(sample_harmonic_map(8)[0].parameters, views=Views.ANY)
    tag = basis_tag("d", parameters)
    r1, r2 = parameters.ranks
    for needed in ({"ranks": (r1, r2 - 2)}, {"sensor_height_m": 2.5}, {"views": Views.FULL}):
        assert basis_tag("d", replace(parameters, **needed)) != tag
    for of_maps in ({"segmentation": Segmentation.UNEQUAL}, {"verification_images": True}):
        changed: MapParameters = replace(parameters, **of_maps)
        assert changed != parameters
        assert basis_tag("d", changed) == tag
