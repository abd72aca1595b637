"""Makes pages of the Markdown files outside of docs/, and resolves links as a Git host does.

A link to a file that is not part of the site leads to the repository, if mkdocs.yml has its `repo_url`.
Otherwise the path of the file is written after the text of the link. A link to a file that the repository does not have
is an error of the strict build.
"""

import logging
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

#: Files outside of docs/ that are pages, and the names of these pages.
PAGES = {
    "README.md": "overview.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "python/README.md": "python-package.md",
}
#: Code, in which nothing is a link, or the text and the target of a link.
CODE_OR_LINK = re.compile(
    r"^(?P<fence>```+|~~~+).*?^(?P=fence)|(?P<quote>`+).+?(?P=quote)|\[(?P<text>[^\[\]]*)\]\((?P<target>[^()\s]+)\)",
    re.MULTILINE | re.DOTALL,
)

log = logging.getLogger("mkdocs.hooks.links")


def on_files(files, config):
    root = Path(config.config_file_path).parent
    for source, page in PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(root / source)))
    return files


def on_page_markdown(markdown, page, config, files):
    root = Path(config.config_file_path).parent
    source = Path(page.file.abs_src_path).relative_to(root).as_posix()

    def replace(match):
        text, target = match["text"], match["target"]
        if target is None or re.match(r"[a-z]+:|#|/", target):
            return match[0]
        path, hash_sign, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if path.startswith("../") or not (root / path).exists():
            log.warning("%s: the link `%s` leads to no file of the repository", source, target)
            return text
        uri = PAGES.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else "")
        if files.get_file_from_path(uri):
            folder = posixpath.dirname(page.file.src_uri) or "."
            return f"[{text}]({posixpath.relpath(uri, folder)}{hash_sign}{anchor})"
        if config.repo_url:
            return f"[{text}]({config.repo_url.rstrip('/')}/blob/HEAD/{path}{hash_sign}{anchor})"
        return f"{text} (`{path}`)"

    return CODE_OR_LINK.sub(replace, markdown)
