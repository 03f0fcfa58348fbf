"""What a reader finds on a page: its visible text, tags with their attributes, tables as rows of cells."""

from __future__ import annotations

from html.parser import HTMLParser

_VOID = {"img", "br", "meta", "link", "input", "hr"}


class Reading(HTMLParser):
    """A page, read: `words` are all visible text outside of `code`, `code` that within, `tags` (name, attributes) in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.code: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.scripts: list[str] = []
        self._open: list[str] = []
        self.feed(page)
        self.close()
        assert self._open == [], f"not closed: {self._open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self._open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self._open and self._open[-1] == tag, f"</{tag}> closes {self._open[-1:]}"
        self._open.pop()

    def handle_data(self, data):
        if "script" in self._open:
            self.scripts.append(data)
        elif "style" not in self._open:
            (self.code if "code" in self._open else self.words).append(data)
            if self._open[-1:] and {"td", "th"} & set(self._open):
                self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        """All visible text outside of `code`."""
        return " ".join(" ".join(self.words).split())

    def of(self, tag: str) -> list[dict[str, str | None]]:
        """Return the attributes of all tags of a kind."""
        return [attributes for name, attributes in self.tags if name == tag]

    def keys(self) -> list[str]:
        """Return what looks like a key of a program, in the visible text and in what is read aloud."""
        said = self.text.split() + [word for image in self.of("img") for word in (image["alt"] or "").split()]
        return [word for word in said if "_" in word]
