"""Reports: what is in them is text, and they need nothing but themselves."""

from html.parser import HTMLParser

from soft_limb.reports import page


class Reader(HTMLParser):
    """Collects text by tag, and complains of tags that are closed in the wrong order."""

    def __init__(self):
        super().__init__()
        self.open, self.texts, self.attributes = [], {}, []

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and data.strip():
            self.texts.setdefault(self.open[-1], []).append(data)


def read(text: str) -> Reader:
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    return reader


def test_page_holds_its_parts_as_text(tmp_path):
    path = tmp_path / "report.html"
    page.write_page(
        path,
        "a < b & c",
        [
            page.section("Q = <Q>", page.paragraph("φ & <b>"), page.items(["<i>", "2"])),
            page.preformatted("k:  1\n  <l>"),
            page.table(["name", "°"], [["<k>", "-1.5"], ["b", "± 2"]], "measured & counted"),
        ],
    )
    texts = read(path.read_text(encoding="utf-8")).texts
    assert texts["title"] == texts["h1"] == ["a < b & c"]
    assert texts["h2"] == ["Q = <Q>"]
    assert texts["p"] == ["φ & <b>"]
    assert texts["li"] == ["<i>", "2"]
    assert texts["pre"] == ["k:  1\n  <l>"]
    assert texts["th"] == ["name", "°"]
    assert texts["td"] == ["<k>", "-1.5", "b", "±\u00a02"]  # no line break within
    assert texts["caption"] == ["measured & counted"]
