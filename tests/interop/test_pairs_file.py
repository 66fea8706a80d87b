# SPDX-License-Identifier: BSD-3-Clause
"""Pairs files: two names a line, also with blanks in the names, and what is refused."""

import pytest

from epi360.interop.pairs_file import read_pairs_file, write_pairs_file


@pytest.fixture
def written(tmp_path):
    def write(content):
        path = tmp_path / "pairs.txt"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def test_a_line_holds_two_names_and_keeps_their_order(written):
    path = written("seq/b.jpg seq/a.jpg\nc.jpg\ta.jpg\n")
    assert read_pairs_file(path) == [("seq/b.jpg", "seq/a.jpg"), ("c.jpg", "a.jpg")]


def test_comments_empty_lines_windows_ends_and_a_byte_order_mark_are_skipped(written):
    path = written("\ufeff# pairs\r\n\r\na.jpg   b.jpg  \r\n  # more\r\nb.jpg c.jpg")
    assert read_pairs_file(path) == [("a.jpg", "b.jpg"), ("b.jpg", "c.jpg")]


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("hall 1.jpg\thall 2.jpg", None),
        ('"hall 1.jpg" "hall 2.jpg"', None),
        ('"hall 1.jpg"\t"hall 2.jpg"', None),
        ("hall 1.jpg hall 2.jpg", {"hall 1.jpg", "hall 2.jpg", "2.jpg"}),
    ],
)
def test_names_with_blanks_need_quotes_a_tab_or_the_known_names(written, line, names):
    assert read_pairs_file(written(line), names=names) == [("hall 1.jpg", "hall 2.jpg")]


def test_one_quoted_name_and_one_plain_name_may_share_a_line(written):
    path = written('"hall 1.jpg" b.jpg\nc.jpg "hall 1.jpg"')
    assert read_pairs_file(path) == [("hall 1.jpg", "b.jpg"), ("c.jpg", "hall 1.jpg")]


def test_names_keep_letters_and_spaces_of_any_script(written):
    pair = ("Küche/左 1.jpg", "Bildschirmfoto 10.04\u202fPM.jpg")  # a space that is no separator
    path = written("")
    write_pairs_file(path, [pair])
    assert read_pairs_file(path) == [pair]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a.jpg b.jpg\n\nc.jpg\n", "line 3: expected two image names, got 'c.jpg'"),
        ("a.jpg b.jpg c.jpg", "line 1: expected two image names.*double quotes"),
        ("a.jpg b.jpg\nb.jpg c.jpg\na.jpg b.jpg", "line 3: .* is there already, in line 1"),
        ("a.jpg b.jpg\nb.jpg a.jpg", "line 2: .* already in the other order, in line 1"),
        ("a.jpg a.jpg", "line 1: a pair needs two images, got a.jpg twice"),
        ("# nothing\n", "has no pairs"),
        (b"\xff\xfe\x00", "must be UTF-8 text"),
    ],
)
def test_a_bad_file_is_refused_with_the_line(written, content, message):
    with pytest.raises(ValueError, match=message):
        read_pairs_file(written(content))


def test_a_line_that_the_known_names_split_in_two_ways_is_refused(written):
    names = {"a", "a b", "b c", "c"}
    with pytest.raises(ValueError, match="line 1: expected two image names, got 'a b c'"):
        read_pairs_file(written("a b c"), names=names)


def test_a_pair_in_both_orders_may_be_taken_once(written):
    path = written("a b\nb a\nb c\n")
    assert read_pairs_file(path, both_orders=True) == [("a", "b"), ("b", "c")]
    with pytest.raises(ValueError, match="line 2: .* is there already, in line 1"):
        read_pairs_file(written("a b\na b\n"), both_orders=True)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no\.txt does not exist"):
        read_pairs_file(tmp_path / "no.txt")
    with pytest.raises(ValueError, match="is a folder"):
        read_pairs_file(tmp_path)


def test_written_pairs_are_plain_where_they_can_be(tmp_path):
    path = tmp_path / "pairs.txt"
    pairs = [("a/1.jpg", "b/2.jpg"), ("hall 1.jpg", "x.jpg"), ("#1.jpg", "\tx"), ("o'x.jpg", 'a"b')]
    write_pairs_file(path, pairs)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["a/1.jpg b/2.jpg", '"hall 1.jpg" x.jpg']
    assert read_pairs_file(path) == pairs


@pytest.mark.parametrize("name", ["", "two\nlines.jpg", 'say "a b".jpg'])
def test_a_name_that_no_line_can_hold_is_refused_and_the_file_kept(tmp_path, name):
    path = tmp_path / "pairs.txt"
    write_pairs_file(path, [("a", "b")])
    with pytest.raises(ValueError, match="cannot stand in a pairs file"):
        write_pairs_file(path, [("a", "c"), ("a", name)])
    assert read_pairs_file(path) == [("a", "b")]


@pytest.mark.parametrize("line", ["a " * 1_000_000, '" ' * 1_000_000, '"' * 1_000_000])
def test_a_file_of_one_long_line_is_refused_at_once(tmp_path, line):
    path = tmp_path / "pairs.txt"
    path.write_text(line)
    with pytest.raises(ValueError, match=r"line 1: expected two image names, got \d+ characters"):
        read_pairs_file(path, names=["a"])
