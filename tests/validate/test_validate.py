"""The command `substep validate`: its list holds, and what is wrong is told and ends in 1."""

import math
import xml.etree.ElementTree as ET

import pytest
import substep
from substep import InputError, validate
from substep.cli import main
from substep.validate import Case, Outcome, catalogue


def case(measured, **options):
    options = {"figure": 2.0, "relative": 0.01, **options}
    return Case(
        "length <of> a rod & more", "rods", "closed form", measure=lambda: measured, **options
    )


def table(path):
    """The cells of each row of a page, which is well-formed."""
    page = ET.fromstring(path.read_text(encoding="utf-8"))
    return [
        ["".join(cell.itertext()) for cell in row.findall("td")]
        for row in page.iter("tr")
        if row.find("td") is not None
    ]


@pytest.mark.slow
def test_the_quick_list_holds(tmp_path, capsys):
    page = tmp_path / "page.html"
    code = main(["validate", "--quick", "--out", str(page)])
    out, err = capsys.readouterr()
    chosen = validate.cases(quick=True)
    assert (code, err) == (0, ""), out
    rows = table(page)
    assert [row[0].split(c.source)[0] for row, c in zip(rows, chosen, strict=True)] == [
        c.name for c in chosen
    ]
    assert {row[-1] for row in rows} == {"ok", "misses, as it must"}
    assert substep.__version__ in page.read_text(encoding="utf-8")


def test_there_are_cases_and_controls_of_every_method():
    everything = validate.cases()
    assert len(everything) >= 40 and len({(c.method, c.name) for c in everything}) == len(
        everything
    )
    for method in catalogue.METHODS:
        own = validate.cases(method)
        assert own == tuple(c for c in everything if c.method == method)
        assert len(own) >= 3
        if method != "rigid":
            assert any(c.quick for c in own)
        assert any(c.control for c in own), method
    assert validate.cases("ODE") == validate.cases("ode")
    assert set(validate.cases(quick=True)) < set(everything)


def test_what_fails_is_listed_and_ends_in_1(tmp_path, monkeypatch, capsys):
    def explode():
        raise substep.SolverError("no <way>")

    cases = [
        case(2.01),
        case(2.1),
        case(2.1, control=True),
        case(2.01, control=True),
        case(math.inf, control=True),
        case(math.nan),
        Case("what explodes", "bombs", "closed form", 1.0, explode, absolute=0.1, control=True),
    ]
    passed = [True, False, True, False, True, False, False]
    outcomes = validate.run(cases)
    assert [outcome.passed for outcome in outcomes] == passed
    monkeypatch.setattr(catalogue, "CASES", tuple(cases))
    page = tmp_path / "page.html"
    assert main(["validate", "--out", str(page)]) == 1
    out, err = capsys.readouterr()
    assert err == "substep: 4 of 7 cases failed\n"
    assert "failed: bombs: what explodes SolverError: no <way>" in out
    rows = table(page)
    assert [row[-1] == "FAILED" for row in rows] == [not good for good in passed]
    assert [row[1:3] for row in rows[-2:]] == [["2", "± 0.02"], ["1", "± 0.1"]]
    text = page.read_text(encoding="utf-8")
    assert "length &lt;of&gt; a rod &amp; more" in text and "no &lt;way&gt;" in text


def test_errors_are_parts_of_the_figure():
    assert Outcome(case(2.01), 2.01, 0.1).off() == "+0.5 %"
    assert Outcome(case(0.1, figure=0.0, absolute=1.0), 0.1, 0.1).off() == "+0.1"
    assert Outcome(case(-2.02, figure=-2.0), -2.02, 0.1).off() == "-1 %"
    assert case(0, figure=-2.0).low == -2.02


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "rigids"], "--method: expected one of ode, fields"),
        (["--out", "page.txt"], "--out: expected a file ending in .html"),
        (["--quik"], "unrecognized arguments: --quik"),
    ],
)
def test_bad_options_are_refused(arguments, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["validate", *arguments]) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wrong", "error", "told"),
    [
        ({"name": " "}, InputError, "name: expected a text"),
        ({"source": 3}, TypeError, "source: expected a text, got 3"),
        ({"figure": math.nan}, InputError, "figure"),
        ({"measure": 2.0}, TypeError, "measure: expected a callable"),
        ({"relative": -1.0}, InputError, "relative"),
        ({"relative": 0.0}, InputError, "a band that has a width"),
    ],
)
def test_wrong_cases_are_refused(wrong, error, told):
    good = {"name": "a", "method": "b", "source": "c", "figure": 1.0, "measure": float}
    with pytest.raises(error, match=told):
        Case(**{**good, "relative": 0.1, **wrong})


def test_wrong_arguments_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least one"):
        validate.run([])
    with pytest.raises(TypeError, match=r"substep\.validate\.Case, got 3"):
        validate.run([case(2.0), 3])
    with pytest.raises(InputError, match="method: expected one of"):
        validate.cases("gridflow")
    with pytest.raises(InputError, match="outcomes"):
        validate.write_page([], tmp_path / "page.html")
    with pytest.raises(TypeError, match="outcomes"):
        validate.write_page([case(2.0)], tmp_path / "page.html")
    with pytest.raises(OSError):
        validate.write_page(validate.run([case(2.0)]), tmp_path / "none" / "page.html")


def test_the_page_says_what_was_left_out(tmp_path):
    page = tmp_path / "page.html"
    good = validate.cases("pbd")
    given = [Outcome(c, c.low - 1 if c.control else c.figure, 0.1) for c in good]
    validate.write_page(given, page)
    text = page.read_text(encoding="utf-8")
    assert "<p>All cases of these methods.</p>" in text
    assert text.count("#c77700") == sum(c.control for c in good) > 0
    assert '<th class="number">Reference</th>' in text and "<th>Case</th>" in text
    quick = [outcome for outcome in given if outcome.case.quick]
    validate.write_page(quick, page)
    left = len(given) - len(quick)
    told = f"Not all cases of these methods: as with --quick, {left} are left out."
    assert (told if left else "All cases") in page.read_text(encoding="utf-8")
    validate.write_page(given[:1], page)
    assert "Not all cases of these methods:" in page.read_text(encoding="utf-8")
    validate.write_page([Outcome(case(2.0), 2.0, 0.1)], page)
    assert "not among those of substep validate" in page.read_text(encoding="utf-8")
