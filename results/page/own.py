"""Which pages this program may replace: those whose last line holds the hash of the rest; any other is a user's.

A page can so be rewritten by processes that share a folder, none of which needs to know of the others.
"""

import hashlib
import os
from pathlib import Path

from palpate.common.files import replacing
from palpate.common.output import ForeignFile

INDEX, CLIP = "index.html", "page.html"
"""Page of a batch in its folder, and of a clip in that clip's."""
_END = b"<!-- palpate %s -->\n"


def is_own(path: Path) -> bool:
    """Whether a file is a page as this program wrote it.

    Raises:
        OSError: it can't be read.
    """
    if path.name not in (INDEX, CLIP) or not path.is_file() or path.is_symlink():
        return False
    content = path.read_bytes()
    body = content[: -len(_last_line(b""))]
    return content == body + _last_line(body)


def write_own(path: Path, text: str) -> None:
    """Store a page under a temporary name, then rename it.

    Raises:
        ForeignFile: something is there that is not as this program wrote it.
        OSError: it can't be written.
    """
    if os.path.lexists(path) and not is_own(path):
        raise ForeignFile(path)
    body = text.encode("utf-8", "replace")  # of stand-ins for bytes of file names that are not UTF-8
    with replacing(path) as partial:
        partial.write_bytes(body + _last_line(body))


def _last_line(body: bytes) -> bytes:
    return _END % hashlib.sha256(body).hexdigest().encode()
