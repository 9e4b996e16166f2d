"""Terms that were replaced do not come back: they had private meanings that a reader had to translate."""

import io
import re
import subprocess
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

NAMES = {
    "asked": "adverbs, goal or request, by what it holds",
    "told": "what it is: a response, a message, `info`",
    "beat": "ticker or tick",
    "guests": "sessions",
    "keeper": "store_sync",
    "demand": "usage",
    "course": "checkpoint or progress",
    "talk": "connection or reader",
    "serving": "state, or what it holds",
}
"""Identifiers in Python, and what to say instead. ``asked`` alone stood for eleven things."""

PHRASES = {
    r"\bwas asked\b|\bwere asked\b|\basked for\b": "requested",
    r"\bis told\b|\bare told\b|\btold about\b": "receives, is reported",
    r"\bnobody\b(?![@\"])": "no one is meant by most of them; say what does not happen",
    r"\bsomebody\b": "name who: a client, another process",
    r"\bwhoever\b": "name the caller or the role",
    r"\bsay so\b|\bsays so\b|\bsaid so\b": "state, or name the field that reports it",
    r"\bno trouble\b|\bway round\b|\blast words\b|\bbreathe\b": "use the technical term",
    r"\bdrawn back to\b": "moved to (the nearest point of the domain)",
    r"\bgoes on\b|\bgo on\b": "continues",
    r"\b(says|tells|believes?)\b": "states, shows, reports; means, trusts",
    r"\blets? go\b": "leaves, releases, ends",
    r"\b(does|do) not know\b": "lacks, has no, is unknown to",
    r"\bhow far off\b|\bhow far it is from\b": "the error",
}
"""Phrases in texts, and what to write instead."""

_EXEMPT = {"tests/test_words.py", "CHANGELOG.md", "tests/service/store/test_migrations.py"}
_SUFFIXES = {".py", ".ts", ".md", ".toml", ".yml", ".css"}


def files(*suffixes):
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    if not listed:
        pytest.skip("this is not a git checkout")
    found = [name for name in listed if Path(name).suffix in suffixes and "/generated/" not in name]
    return [name for name in found if name not in _EXEMPT and (ROOT / name).exists()]


def identifiers(text):
    return {row.string for row in tokenize.generate_tokens(io.StringIO(text).readline) if row.type == tokenize.NAME}


def test_replaced_names_are_gone():
    found = [
        f"{name}: {word} ({NAMES[word]})"
        for name in files(".py")
        for word in sorted(NAMES.keys() & identifiers((ROOT / name).read_text(encoding="utf-8")))
    ]
    assert not found, "\n".join(found)


def test_replaced_phrases_are_gone():
    found = [
        f"{name}:{number}: {match.group()} ({instead})"
        for name in files(*_SUFFIXES)
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), 1)
        for phrase, instead in PHRASES.items()
        if (match := re.search(phrase, line, re.IGNORECASE))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "asked = 1",
        "def aim(self, told): ...",
        "# nobody listens",
        "the goal that was asked",
        "it goes on",
        "the file says",
    ],
)
def test_the_check_finds_them(line):
    names = NAMES.keys() & identifiers(line)
    assert names or any(re.search(phrase, line, re.IGNORECASE) for phrase in PHRASES)
