"""Checks that every link of a built site leads to a file of the site, and to an anchor that exists.

Also checks that no page loads a script, style or picture from another host.

usage: site_links.py SITE
"""

import pathlib
import sys
import tempfile
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

#: The attributes that contain a link, by element.
LINKS = {"a": "href", "img": "src", "link": "href", "script": "src", "source": "src", "iframe": "src"}


class Page(HTMLParser):
    """The anchors of a page, its links, and the links that a browser loads with the page."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.loaded = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.anchors.update(values[key] for key in ("id", "name") if values.get(key))
        if tag in LINKS and values.get(LINKS[tag]) is not None:
            self.links.append(values[LINKS[tag]])
            if tag != "a" and values.get("rel") != "canonical":
                self.loaded.append(values[LINKS[tag]])


def faults(site):
    """The number of links within the site, and a line for each link that leads nowhere."""
    site = site.resolve()
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    n_links, found = 0, []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            name = f"{path.relative_to(site)}: {link}"
            if parts.scheme in ("http", "https", "mailto", "data"):
                if parts.hostname in ("localhost", "127.0.0.1"):
                    found.append(f"{name}: leads to this machine")
                elif parts.hostname and link in page.loaded:
                    found.append(f"{name}: loaded from another host")
                continue
            if parts.scheme or parts.netloc:
                found.append(f"{name}: neither in the site nor on the web")
                continue
            n_links += 1
            target = path
            if parts.path.startswith("/"):
                # A server shows 404.html for any address, so its links start at the root of the site.
                if path.name != "404.html":
                    found.append(f"{name}: an absolute path")
                    continue
                target = (site / unquote(parts.path).lstrip("/")).resolve()
            elif parts.path:
                target = (path.parent / unquote(parts.path)).resolve()
            if target.is_dir():
                target /= "index.html"
            if not target.is_relative_to(site) or not target.is_file():
                found.append(f"{name}: no such file")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{name}: no such anchor")
    return n_links, found


def broken_links_are_found():
    with tempfile.TemporaryDirectory() as folder:
        site = pathlib.Path(folder)
        good = '<h2 id="a-b">A</h2><a href="#a-b"></a><a href="two.html#c%20d"></a><img src="x.png"><a href="https://example.org"></a>'
        (site / "index.html").write_text(good)
        (site / "two.html").write_text('<a name="c d"></a><a href="."></a>')
        (site / "x.png").touch()
        assert faults(site) == (4, []), faults(site)
        for link, fault in {
            "three.html": "no such file",
            "../index.html": "no such file",
            "two.html#a-b": "no such anchor",
            "#c": "no such anchor",
            "/two.html": "an absolute path",
            "file:///two.html": "neither in the site nor on the web",
            "http://localhost:8000/": "leads to this machine",
        }.items():
            (site / "index.html").write_text(f'{good}<a href="{link}"></a>')
            assert faults(site)[1] == [f"index.html: {link}: {fault}"], (link, faults(site))
        (site / "index.html").write_text('<script src="https://example.org/a.js"></script>')
        assert faults(site)[1] == ["index.html: https://example.org/a.js: loaded from another host"], faults(site)


if __name__ == "__main__":
    broken_links_are_found()
    n_links, found = faults(pathlib.Path(sys.argv[1]))
    if found:
        sys.exit("\n".join(found))
    assert 0 < n_links, "the site has no links"
    print(f"{n_links} links within the site, all lead to a file and an anchor")
