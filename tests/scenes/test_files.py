"""Configuration files: every fault ends with code 2, one line that tells its place, and no file."""

import os
import re
import sys

import pytest
from substep import FormatError, InputError
from substep.cli import main
from substep.scenes.run_config import SIZE_LIMIT, read_config

GOOD = """\
# a comment that mentions frames = 3
scene = "kepler"
frames = 11
fps = 2.0
seed = 7
threads = 2
out = "runs/mine"

[parameters]
steps = 300
"methods" = ["rk4", "yoshida4"]
"""


def fails(folder, capsys, text, *options):
    """The line that `run` prints about a configuration; it must leave no trace."""
    file = folder / "run.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    before = sorted(folder.rglob("*"))
    assert main(["run", "--config", "run.toml", *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "Traceback" not in err
    assert sorted(folder.rglob("*")) == before
    return err.rstrip("\n")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_reads_all_keys(folder):
    (folder / "run.toml").write_text(GOOD)
    config = read_config("run.toml")
    assert config.values == {
        "scene": "kepler", "frames": 11, "fps": 2.0, "seed": 7, "threads": 2, "out": "runs/mine",
    }  # fmt: skip
    assert config.parameters == {"steps": 300, "methods": ["rk4", "yoshida4"]}


@pytest.mark.parametrize(
    ("line", "place", "words"),
    [
        ("frmes = 3", "1:1: frmes", "did you mean frames?"),
        ("scene = 3", "1:1: scene", "expected a text, got 3"),
        ("frames = 2.5", "1:1: frames", "expected an integer of at least 2, got 2.5"),
        ("frames = true", "1:1: frames", "got true"),
        ("frames = 1", "1:1: frames", "at least 2, got 1"),
        ("frames = '9'", "1:1: frames", "got '9'"),
        ("frames = [9]", "1:1: frames", "got a list"),
        ("fps = nan", "1:1: fps", "expected a finite number above 0, got nan"),
        ("fps = inf", "1:1: fps", "got inf"),
        ("fps = 1e999", "1:1: fps", "got inf"),
        ("fps = -1", "1:1: fps", "got -1"),
        ("fps = 2021-01-01", "1:1: fps", "got datetime.date(2021, 1, 1)"),
        ("threads = 0", "1:1: threads", "from 1 to 1024, got 0"),
        ("seed = -1", "1:1: seed", "got -1"),
        ("seed = 99999999999999999999", "1:1: seed", "got 99999999999999999999"),
        ("parameters = 3", "1:1: parameters", "expected a table"),
        ("out = ''", "1:1: out", "inside the folder"),
        ("frames = 3\nframes = 4", "2:11: frames", "Cannot overwrite a value"),
        ("frames = 3\n[parameters]\nsteps = 1\nsteps = 2", "4:10: steps", "Cannot overwrite"),
        ("frames = ", "1:10: frames", "Invalid value"),
        ("frames = NaN", "1:10: frames", "Invalid value"),
        ("frames", "1:7: file", "Expected '='"),
        ("frames = 3 # \x07", "1:14: frames", "invalid character"),
        ("[parameters]\nsteps = 'x'", "2:1: steps", "expected an integer from 1 to 1e+07, got 'x'"),
        ("[parameters]\nsteps = nan", "2:1: steps", "got nan"),
        ("[parameters]\nstpes = 1", "2:1: stpes", "did you mean steps?"),
        ("[parameters]\nduration = '60 days'", "2:1: duration", "[periods], got '60 days'"),
        ("[parameters]\neccentricity = 1.5", "2:1: eccentricity", "from 0 to 0.99, got 1.5"),
        ("[parameters]\nmethods = ['rk4', 3]", "2:1: methods", "expected some of"),
        ("[parameters]\nmethods = []", "2:1: methods", "expected some of"),
        ("[parameters.steps]\nn = 1", "1:13: steps", "got a table"),
        ("parameters.steps = 0", "1:12: steps", "got 0"),
        ("parameters = {eccentricity = 0.1, steps = 0}", "1:35: steps", "got 0"),
        ("frames = 3\n# steps = 1\n[parameters]\n\n  'steps' = 0", "5:3: steps", "got 0"),
        ("out = '''\nsteps = 1'''\n[parameters]\nsteps = 0", "4:1: steps", "got 0"),
        ("[parameters]\nmethods = ['''\nsteps = 1''']\nsteps = 0", "2:1: methods", "expected some"),
    ],
)
def test_names_file_line_column_and_key(folder, capsys, line, place, words):
    text = line if "scene" in line else f"{line}\n"
    options = () if "scene" in line else ("kepler",)
    message = fails(folder, capsys, text, *options)
    assert message.startswith(f"run.toml:{place}: "), message
    assert words in message


def test_finds_a_key_behind_a_text_that_mentions_it(folder):
    text = 'scene = """\nseed = 1\n"""\n[parameters]\nseed = 2\n'
    (folder / "run.toml").write_text(text)
    with pytest.raises(InputError):
        read_config("run.toml")
    (folder / "run.toml").write_text(text.replace("scene", "out").replace("\n", " ", 2))
    config = read_config("run.toml")
    assert config.where("seed", "parameters") == "run.toml:3:1: seed"


@pytest.mark.parametrize(
    ("data", "place", "words"),
    [
        (b"\xef\xbb\xbfframes = 3\n", "1:1", "byte order mark"),
        ("frames = 3\n".encode("utf-16"), "1:1", "UTF-16"),
        ("frames = 3\n".encode("utf-16-be"), "1:1", "NUL"),
        (b"frames = 3\nseed = \0\n", "2:8", "NUL"),
        (b"frames = 3\n# \xff\n", "2:3", "not UTF-8"),
        (b"seed = " + b"[" * 100_000, "1:1", "longer than"),
        (b"seed = " + b"{a=" * 100_000, "1:1", "longer than"),
        (b"seed = " + b"[" * 4000, "1:1", "nested too deeply"),
        (b"seed = " + b"[\n" * 30_000, "1:1", "nested too deeply"),
        (b"seed = " + b"{a=" * 1300, "1:1", "nested too deeply"),
        (b"seed = 1\n# " + b"." * 5000, "2:1", "line longer"),
        (b"#" * (SIZE_LIMIT + 1), "1:1", "longer than"),
        (b"{}", "1:1", "Invalid statement"),
        (b"a = [1,\n", "2:1", "Invalid value"),
        (b'a = """\n', "2:1", "Unterminated string"),
    ],
    ids=[
        "bom",
        "utf16",
        "utf16be",
        "nul",
        "latin1",
        "lists",
        "tables",
        "lists4000",
        "lines",
        "tables1300",
        "line",
        "long",
        "json",
        "list",
        "text",
    ],
)
def test_refuses_what_is_no_toml_text(folder, capsys, data, place, words):
    message = fails(folder, capsys, data, "kepler")
    assert message.startswith(f"run.toml:{place}: ") and words in message
    assert len(message) < 200
    with pytest.raises(FormatError):
        read_config("run.toml")


def test_deep_nesting_of_keys_is_told_in_short(folder, capsys):
    message = fails(folder, capsys, b".".join([b"a"] * 2000) + b" = 1", "kepler")
    assert re.match(r"run\.toml:1:1: (a: unknown key|file: nested)", message)
    assert len(message) < 200


def test_an_integer_of_more_digits_than_python_reads(folder, capsys):
    limit = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(640)
    try:
        message = fails(folder, capsys, "seed = " + "9" * 4000, "kepler")
    finally:
        sys.set_int_max_str_digits(limit)
    assert message.startswith("run.toml:1:1: file: ")


def test_a_gigabyte_is_refused_at_once(folder, capsys):
    with open(folder / "big.toml", "wb") as file:
        file.truncate(1 << 30)  # sparse
    assert main(["run", "kepler", "--config", "big.toml"]) == 2
    assert "longer than" in capsys.readouterr().err


def test_many_mentions_of_a_key_take_no_time(folder, capsys):
    text = "out = '''\n" + "steps = 1\n" * 6_000 + "'''\n[parameters]\nsteps = 0\n"
    assert "steps" in fails(folder, capsys, text.replace("out", "scene"), "kepler")


@pytest.mark.parametrize(
    "name",
    ["../x", "a/../../x", "/x/y", "\\x", "C:x", "CON", "a/nul.txt", "LPT1", "n" * 300, "a/" * 750,
     "tab\\there", "\\u0000"],
    ids=lambda name: name[:12],
)  # fmt: skip
@pytest.mark.parametrize("key", ["out", "scene"])
def test_paths_stay_inside_the_folder(folder, capsys, key, name):
    quoted = f'"{name}"' if "\\t" in name or "\\u" in name else f"'{name}'"
    message = fails(folder, capsys, f"{key} = {quoted}\n", "kepler")
    assert message.startswith(f"run.toml:1:1: {key}: "), message


def test_out_does_not_follow_a_link_out_of_the_folder(folder, capsys, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    os.symlink(elsewhere, folder / "link")
    assert "link" in fails(folder, capsys, "out = 'link/x'\n", "kepler")
    assert not list(elsewhere.iterdir())


@pytest.mark.parametrize("make", ["missing", "folder", "unreadable"])
def test_a_file_that_cannot_be_read(folder, capsys, make):
    if make == "folder":
        (folder / "run.toml").mkdir()
    if make == "unreadable":
        (folder / "run.toml").symlink_to("run.toml")  # a loop; root reads everything else
    assert main(["run", "kepler", "--config", "run.toml"]) in (1, 2)
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("substep: run.toml: ") and err.count("\n") == 1
