import subprocess
import sys
from pathlib import Path

import pytest
from page_runner import blocks_of, difference, run_page

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
QUICK = {"own_controller"}
"""The others take minutes."""

PAGE = """# Page

```python
# helper.py
answer = 42
```

```python
kept = 1.0
```

Text.

```sh
cat helper.py; pwd
```

```python
print(f"{kept + 0.5:.2f} mm")
```

```output
1.50 mm
```

```json
{"for": "reading"}
```
"""


def test_blocks_share_a_namespace_and_a_folder(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert [block.line for block in blocks_of(PAGE)] == [3, 8, 14, 18, 22, 26]
    ran = list(run_page(page, tmp_path))
    assert [block.file for block, _, _ in ran] == ["helper.py", None, None, None]
    assert ran[2][1] == f"# helper.py\nanswer = 42\n{tmp_path}\n"
    assert ran[3][1:] == ("1.50 mm\n", "1.50 mm\n")


def test_a_shell_block_that_fails_is_an_error(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```sh\nfalse\ntrue\n```\n")
    with pytest.raises(subprocess.CalledProcessError):
        list(run_page(page, tmp_path))


@pytest.mark.parametrize(
    ("said", "printed", "equal"),
    [
        ("0.07 mm\n", "0.07 mm\n", True),
        ("0.07 mm\n", "0.08 mm\n", True),
        ("0.07 mm\n", "0.10 mm\n", False),
        ("100 steps\n", "104 steps\n", True),
        ("100 steps\n", "110 steps\n", False),
        ("ended by success\n", "ended by time\n", False),
        ("a  b\nc\n", "a b\n c\n", True),
        ("first ... last\n", "first 1 2 3\nlast\n", True),
        ("-1.5e-05\n", "-1.5e-05\n", True),
        ("1 2\n", "1\n", False),
    ],
)
def test_numbers_may_differ_in_their_last_place_and_words_not_at_all(said, printed, equal):
    assert (difference(said, printed) is None) is equal


def test_every_tutorial_is_run_somewhere():
    assert {page.stem for page in TUTORIALS.glob("*.md")} > QUICK


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[] if page.stem in QUICK else [pytest.mark.slow, pytest.mark.timeout(3600)])
        for page in sorted(TUTORIALS.glob("*.md"))
        if page.stem != "index"
    ],
)
def test_a_tutorial_does_what_it_prints(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    # What Python found for "." belongs to the folder of the page before.
    sys.path_importer_cache.pop(".", None)
    for block, printed, said in run_page(page, tmp_path):
        wrong = None if said is None else difference(said, printed)
        assert wrong is None, f"{page.name}:{block.line}: {wrong}"
