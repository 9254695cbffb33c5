"""What a camera keeps of a traced moment, and when it must not."""

import numpy as np


def test_an_image_is_the_same_whether_its_geometry_was_asked_for_before_or_not(camera, plate_before_wall):
    camera.attach_geometry(plate_before_wall())
    aside = np.eye(4)
    aside[0, 3] = 0.004
    near, far = (camera.snapshot(None, pose) for pose in (np.eye(4), aside))
    expected = [camera.render(one, np.random.default_rng(number)) for number, one in enumerate((near, far))]
    for number, one in enumerate((near, far)):
        view = camera.exact_view(one)
        image = camera.render(one, np.random.default_rng(number))
        np.testing.assert_array_equal(image.image, expected[number].image)
        np.testing.assert_array_equal(view.lit, image.lit)
    # What another moment has left behind counts for nothing.
    camera.exact_view(near)
    camera.depth_view(far)
    np.testing.assert_array_equal(camera.render(near, np.random.default_rng(0)).electrons, expected[0].electrons)
    camera.exact_view(near)
    np.testing.assert_array_equal(camera.render(far, np.random.default_rng(1)).electrons, expected[1].electrons)
