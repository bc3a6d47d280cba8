#!/usr/bin/env python3
"""Fails if prose departs from the project's style: `.ci/prose.py PATH...`, in the root of the repository.

Counts the phrasings below in comments and strings of .rs files, in .md files outside code, and in docstrings and
comments of .py files. Each is at least eight times as frequent in this project's early texts as in 29 crates (arrow,
clap, jiff, nalgebra, object_store, rayon ...). A room is a folder directly below src, another top-level folder, or a
document. It fails if it has more than LIMIT phrasings per 1000 words, or more than its entry in ALLOWED.
docs/style.md shows how to write instead.
"""
import math
import re
import sys
from collections import defaultdict
from pathlib import Path

LIMIT = 6
SHORT = 500  # words that a room counts as at least, so a short page may contain a few phrasings
SKIPPED = {"target", "node_modules", "seeds", "corpus", "snapshots", "CHANGELOG.md"}
# Rooms above LIMIT. Lower an entry when its room improves; never raise one.
ALLOWED = {
    "docs": 32, "docs/real-logs.md": 7, "docs/rules": 9, "fixtures": 8,
}

PHRASES = r"""what (?:is|was|are|were|it|they|an?|the|no|all|has|had|comes|goes|remains|else)
where (?:it|they|that|those|there|this|no|nothing|none|an?|the|one|two|several|only)
(?:of|by|in|to|from|at) which|by how (?:much|many|far)|so (?:much|many|few)|as (?:it|they) (?:is|are|was|were|would)
(?:is|are|was|were) (?:no(?! longer)|none|other|another|to be|left)|leaves|left of|of (?:it|them)|(?:that|those) of
sa(?:y|ys|id)|(?:un|fore)?tells?|(?:un|fore)?told|stands?|stood|l(?:ies|ay)|beside|anew|hardly|alike|mend(?:s|ed|ing)?
(?:held?|holds?|judged) against|t(?:ake|akes|aken|ook) off|looked at|g(?:ives?|iven|ave) back|go(?:es)? (?:by|on|with)
of (?:its|their|one's) own|ones? (?:that|whose)|has (?:it|them)|all that|nobody|somebody|whoever|whose word|but for
postures?|witness(?:es)?|the drawing"""
START = r"[.:;|]\s+(?-i:Of|By|What|Where)\s[a-z]+"
PHRASE = re.compile(START + r"|\b(?:" + PHRASES.replace("\n", "|").replace(" ", r"\s+") + r")\b", re.I)
PROSE = {  # the groups that are prose, in tokens of the language
    ".rs": r'//[/!]?(?P<a>[^\n]*)|\br(?P<hash>#*)"(?P<b>.*?)"(?P=hash)|"(?P<c>(?:[^"\\]|\\.)*)"'
    + r"|'(?:\\.[^'\n]*|[^\\'\n])'",
    ".py": r'"""(?P<a>.*?)"""|#(?P<b>[^\n]*)|"(?:[^"\\\n]|\\.)*"' + r"|'(?:[^'\\\n]|\\.)*'",
    ".md": r"(?P<a>.+)",
}
CODE = re.compile(r"^[ \t]*#+ .*$|(?s:```.*?```)|`[^`\n]*`|\{[^{}\n]*\}|\\\n|\\n|\]\([^)]*\)", re.M)


def blank(text, sign):
    return re.sub(r"\S", sign, text)


def prose(path):
    """The file with everything but prose blanked, so that offsets and line breaks stay."""
    text, out, end = path.read_text(encoding="utf-8", errors="ignore"), [], 0
    for token in re.finditer(PROSE[path.suffix], text, re.S):
        group = next((g for g, found in token.groupdict().items() if g != "hash" and found is not None), None)
        if group is None or (path.suffix == ".rs" and group != "a" and len(token[group].split()) < 4):
            continue
        # Comment signs become blanks, so that phrases are found across lines.
        sign = " " if path.suffix != ".md" and group != "c" else "|"
        (start, stop), (first, last) = token.span(), token.span(group)
        out += [blank(text[end:start], "|"), blank(text[start:first], sign)]
        out += [text[first:last], blank(text[last:stop], sign)]
        end = stop
    return CODE.sub(lambda code: blank(code[0], "~"), "".join(out) + blank(text[end:], "|"))


def room(path):
    parts = path.parts
    if parts[0] == "src":
        return "/".join(parts[: 2 if len(parts) > 2 else 1])
    return "docs/rules" if parts[:2] == ("docs", "rules") else str(path) if path.suffix == ".md" else parts[0]


def main(paths):
    words, hits = defaultdict(int), defaultdict(list)
    files = {file for path in map(Path, paths) for file in ([path] if path.is_file() else path.rglob("*"))}
    for file in sorted(file for file in files if file.suffix in PROSE and not SKIPPED & set(file.parts)):
        text = prose(file)
        words[room(file)] += len(re.findall(r"[A-Za-z']+", text))
        for hit in PHRASE.finditer(text):
            line = text.count("\n", 0, hit.end()) + 1
            hits[room(file)].append(f"{file}:{line}: {' '.join(hit[0].split()).lstrip('.:;| ')}")
    failed = 0
    for name in sorted(words):
        rate, allowed = 1000 * len(hits[name]) / max(words[name], SHORT), ALLOWED.get(name, LIMIT)
        if rate > allowed:
            failed += 1
            print("\n".join(hits[name]), file=sys.stderr)
        lower = max(LIMIT, math.ceil(rate))
        note = f"more than {allowed}" if rate > allowed else f"lower its entry to {lower}" if allowed > lower else ""
        print(f"{rate:6.1f} per 1000 of {words[name]:6} words  {name}  {note}".rstrip())
    return failed and f"{failed} rooms have too many phrasings; see docs/style.md"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
