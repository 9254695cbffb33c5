import pytest

from laploop.errors import InvalidValueError, LaploopError, MissingFileError, UnknownNameError
from laploop.perception.data.pair_list import PairList

HEADER = "image,cloud,split,scene,tool\n"


@pytest.fixture
def folder(tmp_path):
    for name in ("a.png", "b.png", "c.png", "a.ply", "b.ply", "c.ply"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def test_lines_become_pairs_in_their_order(folder):
    (folder / "pairs.csv").write_text(
        HEADER + "b.png,b.ply,test,heart 2,1\na.png,a.ply,train,heart 1,\nc.png,c.ply,test,heart 2,0\n", encoding="utf-8-sig"
    )
    found = PairList.read(folder)
    assert [pair.image.name for pair in found.pairs] == ["b.png", "a.png", "c.png"]
    assert found.scenes == ("heart 2", "heart 1")
    assert found.scene_number.tolist() == [0, 1, 0]
    assert found.split.tolist() == [2, 0, 2]
    assert found.tool_in_view.tolist() == [True, False, False]
    (folder / "pairs.csv").write_text("scene,split,cloud,image,remark\nx,val,a.ply,a.png,blurred\n")
    assert PairList.read(folder).pairs[0].split == "val"


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("", InvalidValueError, "number of pairs in .* is 0"),
        (HEADER, InvalidValueError, "number of pairs in .* is 0"),
        ("image,cloud,split\na.png,a.ply,test\n", InvalidValueError, "allowed: also scene"),
        (HEADER + "a.png,a.ply,test,x,0\nb.png,,test,x,0\n", InvalidValueError, "cloud in line 3"),
        (HEADER + "a.png,a.ply,holdout,x,0\n", UnknownNameError, "split in line 2.*available: test, train, val"),
        (HEADER + "a.png,a.ply,test,x,yes\n", InvalidValueError, "'yes'; allowed: 0 or 1"),
        (HEADER + "a.png,d.ply,test,x,0\n", MissingFileError, "cloud in line 2 .*d.ply"),
        (HEADER + "a.png,a.ply,test,x,0\na.png,b.ply,test,x,0\n", InvalidValueError, "not in line 2 too"),
        (HEADER + "a.png,a.ply,test,x,0\nb.png,b.ply,train,x,0\n", InvalidValueError, "no scene is trained and tested on"),
    ],
)
def test_faulty_lists_are_refused_with_the_line(folder, text, kind, message):
    (folder / "pairs.csv").write_text(text)
    with pytest.raises(kind, match=message):
        PairList.read(folder)


def test_a_folder_without_a_list_and_a_list_that_is_no_text_are_refused(folder):
    with pytest.raises(MissingFileError, match="list of pairs not found"):
        PairList.read(folder)
    (folder / "pairs.csv").write_bytes(b"\xff\xfe\x00x")
    with pytest.raises(LaploopError, match="a CSV file in UTF-8"):
        PairList.read(folder)
