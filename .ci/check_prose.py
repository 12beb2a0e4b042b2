"""Checks the spelling of all text, by codespell, and the grammar of the pages, by Harper."""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
SPELLED = ["*.cpp", "*.h", "*.md", "*.py", "*.pyi", "*.toml", ".ci", "script"]
# Harper's rules of grammar; the others are of taste, or know neither units nor terms of the field.
GRAMMAR = """AnA AnAnother ComprisesOf CriteriaPhenomena DespiteOf DoesOrDose DontCan DoubleModal
    DoubleNegative HavePassed InflectedVerbAfterTo InterestedIn IsBeenAuxSequence ItsPossessive
    LessWorse LetToDo MayOfPronoun ModalOf ModalSeem MoreAdjective MoreBetter
    MoreThatLikely NeedToNoun OneOfTheSingular PluralDecades PronounAre PronounVerbAgreement
    QuantifierNeedsOf RedundantSuperlatives RepeatedWords SameAs SimilarLike SingleBe
    SomeWithoutArticle SubjectPronoun ThatThan ThatThis TheAnother TheirToThere ThenThan
    ThereIsAgreement ThereToTheir ToLoseTooLoose ToTo TooTo WantBe WasComprisedOf WillNonLemma
    WithoutOut WorthToDo WrongApostrophe""".split()
LISTS_OF_PAGES = re.compile(r"^:::.*?^:::$", re.S | re.M)


def tracked(*patterns: str) -> list[str]:
    """The files that git tracks, by pattern."""
    listed = subprocess.check_output(["git", "ls-files", *patterns], cwd=ROOT, text=True)
    return listed.splitlines()


def grammar() -> list[str]:
    """What Harper finds in the pages."""
    with tempfile.TemporaryDirectory() as folder:
        pages = {name.replace("/", "-"): name for name in tracked("README.md", "docs/*.md")}
        for copy, name in pages.items():
            text = (ROOT / name).read_text()
            text = LISTS_OF_PAGES.sub(lambda block: "\n" * block[0].count("\n"), text)
            Path(folder, copy).write_text(text)
        command = ["harper", "lint", "--quiet", "--format", "json", "--only", ",".join(GRAMMAR)]
        answer = subprocess.run([*command, *pages], cwd=folder, capture_output=True, check=False)
    return [
        f"{pages[page['file']]}:{found['line']}: {found['matched_text']!r}: {found['message']}"
        for page in json.loads(answer.stdout)
        for found in page["lints"]
    ]


if __name__ == "__main__":
    misspelled = subprocess.run(["codespell", *tracked(*SPELLED)], cwd=ROOT, check=False)
    lines = grammar()
    print("\n".join(lines) or "prose: no complaints")
    sys.exit(misspelled.returncode or bool(lines))
