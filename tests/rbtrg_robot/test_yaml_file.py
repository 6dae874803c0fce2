"""YAML from people: what is refused, and in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtrg_robot.yaml_file import LARGEST_FILE, YamlError, parse, read

BOMB = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9, 0]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in zip("abcde", "bcdef", strict=True)
)


def test_plain_values_and_a_few_aliases_are_read() -> None:
    assert parse("a: &a [1, 2.5]\nb: {<<: {c: 3}, d: *a}") == {"a": [1, 2.5], "b": {"c": 3, "d": [1, 2.5]}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 2_000, "recursion|node content"),
        ("seed: " + "9" * 5000, "digits"),
        ("day: 2020-99-99", "month"),
        ("a: !!bool x", "x"),
        ("a: !!timestamp x", "groupdict"),
        ("a: [", "expected"),
        ("a: !!python/object/apply:os.system [ls]", "tag"),
        ("a: 1\nb: 2\na: 3", "'a' stands twice"),
        (BOMB, "aliases"),
        ("&a [*a]", "aliases"),
        (b"\xff\x00", "byte"),
        ("x" * (LARGEST_FILE + 1), "bytes"),
    ],
)
def test_what_is_no_yaml_or_too_much_of_it_is_one_line(text: str | bytes, words: str) -> None:
    with pytest.raises(YamlError, match=words) as refused:
        parse(text)
    assert "\n" not in str(refused.value)


def test_of_a_large_file_no_more_is_read_than_is_taken(tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        file.truncate(10**11)
    with pytest.raises(YamlError, match="bytes"):
        read(tmp_path / "a")
