"""A page of HTML as a browser reads it."""

from html.parser import HTMLParser

VOID = {"meta", "img", "br"}


class Checked(HTMLParser):
    """Every element is closed, in its order; what the page loads, which ids it has and links to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        self.loaded += [given[name] for name in ("src", "srcset", "data") if name in given]
        self.ids += [given["id"]] if "id" in given else []
        (self.links if tag == "a" else self.loaded).extend([given["href"]] if "href" in given else [])

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
