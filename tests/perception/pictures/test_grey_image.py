import cv2
import numpy as np
import pytest
from PIL import Image

from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.estimators.base import to_eight_bits
from laploop.perception.pictures.grey_image import check_pictures, list_pictures, read_grey

SIZE = (48, 64)


@pytest.fixture
def grey():
    return np.random.default_rng(0).integers(0, 256, SIZE, dtype=np.uint8)


@pytest.fixture
def deep():
    return np.random.default_rng(1).integers(0, 4096, SIZE, dtype=np.uint16)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".PNG"])
def test_eight_bits_are_taken_as_they_are(tmp_path, grey, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(cv2.imencode(suffix.lower(), grey)[1].tobytes())
    np.testing.assert_array_equal(read_grey(path, SIZE), grey)
    np.testing.assert_array_equal(read_grey(path, SIZE, bits=12), grey)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_more_bits_are_rounded_like_those_of_a_camera(tmp_path, deep, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(cv2.imencode(suffix, deep)[1].tobytes())
    np.testing.assert_array_equal(read_grey(path, SIZE, bits=12), to_eight_bits(deep, 12))
    np.testing.assert_array_equal(read_grey(path, SIZE), to_eight_bits(deep, 16))


@pytest.mark.parametrize("bits", [8, 16])
def test_three_equal_channels_are_grey(tmp_path, grey, deep, bits):
    values = grey if bits == 8 else deep
    path = tmp_path / "a.png"
    path.write_bytes(cv2.imencode(".png", np.repeat(values[..., None], 3, axis=-1))[1].tobytes())
    np.testing.assert_array_equal(read_grey(path, SIZE), grey if bits == 8 else to_eight_bits(deep, 16))


def test_colour_is_refused_even_of_a_single_pixel_in_the_lowest_of_16_bits(tmp_path, deep):
    colours = np.repeat(deep[..., None], 3, axis=-1)
    colours[3, 4, 0] ^= 1
    path = tmp_path / "a.png"
    path.write_bytes(cv2.imencode(".png", colours)[1].tobytes())
    with pytest.raises(InvalidValueError, match=r"channels of .*a\.png is 1; allowed: 0"):
        read_grey(path, SIZE)


def test_transparency_is_refused_and_an_opaque_channel_is_not(tmp_path, grey):
    for alpha, name in ((255, "opaque.png"), (254, "clear.png")):
        Image.fromarray(np.stack([grey, np.full_like(grey, alpha)], axis=-1)).save(tmp_path / name)
    np.testing.assert_array_equal(read_grey(tmp_path / "opaque.png", SIZE), grey)
    with pytest.raises(InvalidValueError, match="transparent"):
        read_grey(tmp_path / "clear.png", SIZE)


def test_each_bad_file_is_named_with_what_is_allowed(tmp_path, grey, deep):
    whole = cv2.imencode(".png", grey)[1].tobytes()
    (tmp_path / "short.png").write_bytes(whole[: len(whole) // 2])
    tiff = cv2.imencode(".tif", deep)[1].tobytes()
    (tmp_path / "short.tif").write_bytes(tiff[: len(tiff) // 3])
    (tmp_path / "text.png").write_text("not a picture")
    (tmp_path / "none.png").write_bytes(b"")
    (tmp_path / "small.png").write_bytes(cv2.imencode(".png", grey[:40])[1].tobytes())
    (tmp_path / "jpeg.png").write_bytes(cv2.imencode(".jpg", grey)[1].tobytes())
    (tmp_path / "bright.png").write_bytes(cv2.imencode(".png", deep)[1].tobytes())
    Image.fromarray(grey > 127).save(tmp_path / "binary.png")
    Image.fromarray(grey.astype(np.float32)).save(tmp_path / "float.tif")
    Image.fromarray(grey).save(tmp_path / "pages.tif", save_all=True, append_images=[Image.fromarray(grey)])
    for name, message in (
        ("short.png", "a whole PNG or TIFF"),
        ("short.tif", "a whole PNG or TIFF"),
        ("text.png", "a whole PNG or TIFF"),
        ("none.png", "a whole PNG or TIFF"),
        ("jpeg.png", "a whole PNG or TIFF"),
        ("small.png", "'64 x 40'; allowed: 64 x 48, as calibrated"),
        ("bright.png", "at most 1023, as 10 bits hold"),
        ("binary.png", "'1'; allowed: grey values of 8 to 16 bits"),
        ("float.tif", "'F'; allowed: grey values of 8 to 16 bits"),
        ("pages.tif", "is 2; allowed: 1 a file"),
    ):
        with pytest.raises(InvalidValueError, match=message) as error:
            check_pictures([tmp_path / name], SIZE, bits=10)
        assert name in str(error.value)
    with pytest.raises(MissingFileError, match=r"missing\.png"):
        read_grey(tmp_path / "missing.png", SIZE)


def test_pictures_of_a_folder_come_by_name(tmp_path, grey):
    for name in ("b.png", "a.TIF", ".hidden.png", "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in list_pictures(tmp_path)] == ["a.TIF", "b.png"]
    (tmp_path / "b.tiff").write_bytes(b"")
    with pytest.raises(InvalidValueError, match=r"\['b'\]; allowed: names that differ in more than their suffix"):
        list_pictures(tmp_path)
    with pytest.raises(MissingFileError):
        list_pictures(tmp_path / "nowhere")
    with pytest.raises(MissingFileError):
        list_pictures(tmp_path / "b.png")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidValueError, match="0; allowed: 1 or more"):
        list_pictures(tmp_path / "empty")


@pytest.mark.parametrize("bits", [10, 12])
def test_deep_pictures_without_a_bright_value_need_the_cameras_bits(tmp_path, bits):
    deep = np.random.default_rng(0).integers(0, 2**bits, SIZE).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    with pytest.raises(InvalidValueError, match=rf"brightest grey value .* is {deep.max()}; allowed: 4096 or more.*--bits 12"):
        check_pictures([tmp_path / "deep.png"], SIZE)
    check_pictures([tmp_path / "deep.png"], SIZE, bits=bits)
    check_pictures([tmp_path / "deep.png"], SIZE, bits=16)
