import json

import pytest

from aerotube.errors import InputError
from aerotube.results import ensure_folder, out_folder, whole_file, write_json, write_text


def test_a_file_appears_whole(tmp_path):
    write_text(tmp_path / "a.txt", "αβ")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "αβ"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def half_write_and_fail(path):
    with whole_file(path) as aside:
        aside.write_text("half of the n")
        raise KeyboardInterrupt


def test_a_file_that_fails_half_way_leaves_what_was_there(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        half_write_and_fail(target)
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_json_has_no_numbers_that_are_none(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"value": float("nan")})
    assert list(tmp_path.iterdir()) == []
    write_json(tmp_path / "a.json", {"value": None})
    assert json.loads((tmp_path / "a.json").read_text()) == {"value": None}


def test_a_folder_is_made_and_left_empty(tmp_path):
    folder = ensure_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("inside", ["file", "file/deeper/still", "new/../file"])
def test_a_folder_that_cannot_be_is_named_and_nothing_is_left(tmp_path, inside):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=r"out folder .* cannot be written"):
        ensure_folder(tmp_path / inside)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_folders_made_for_nothing_go_again(tmp_path):
    (tmp_path / "mine").mkdir()
    with out_folder(tmp_path / "mine" / "a" / "b") as folder:
        assert folder.is_dir()
    assert list((tmp_path / "mine").iterdir()) == []
    with out_folder(tmp_path / "mine") as folder:
        pass
    assert folder.is_dir()
    with out_folder(tmp_path / "a" / "b") as folder:
        (folder / "file").write_text("kept")
    assert (tmp_path / "a" / "b" / "file").is_file()
