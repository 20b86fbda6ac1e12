"""Links in documents lead to files and headings that exist; the index is complete."""

import pytest

from tests.support.documents import DOCUMENTS, anchors, links
from tests.support.sources import CHECKOUT


@pytest.mark.parametrize(
    "document", DOCUMENTS, ids=lambda path: path.relative_to(CHECKOUT).as_posix()
)
def test_every_link_has_an_existing_target(document):
    text = document.read_text("utf-8")

    broken = [link for link in links(text) if not link_target_exists(document, link)]

    assert broken == []


def link_target_exists(document, link):
    if "://" in link:
        return link.startswith("https://")
    path, _, anchor = link.partition("#")
    target = (document.parent / path) if path else document
    if not target.exists():
        return False
    return not anchor or anchor in anchors(target.read_text("utf-8"))


def test_the_index_lists_every_page():
    index = CHECKOUT / "docs" / "index.md"

    listed = {(index.parent / link).resolve() for link in links(index.read_text())}

    assert set((CHECKOUT / "docs").glob("*.md")) - {index} <= listed
