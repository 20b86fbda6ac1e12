"""Tar archives and a multipart form, mostly valid, for fuzzers to damage."""

import tarfile

from tests.support import archives

FRAMES = archives.frame("a") + archives.frame("b/ü", number=1)
ARCHIVES = [
    archives.tar_archive(FRAMES),
    archives.tar_archive([(f"{'long/' * 30}a.json", b"{}")], tarfile.GNU_FORMAT),
    archives.tar_without_end(FRAMES) + archives.END,
    archives.header_of("././@LongLink", 200, b"L") + b"a" * 512 + archives.END,
    archives.header_of("x", 60, b"x") + b"30 mtime=1\n19 path=a/b.json\n" + bytes(483),
    archives.header_of("a", 0, tarfile.SYMTYPE) + archives.END,
]
BOUNDARY = b"b0undary"
FORM = b"".join(
    b'--%b\r\nContent-Disposition: form-data; name="%b"; filename="a"\r\n'
    b"Content-Type: image/png\r\n\r\n%b\r\n" % (BOUNDARY, name, content)
    for name, content in (
        (b"annotation", b'{"boxes": []}'),
        (b"image", FRAMES[1][1]),
        (b"segmentation", FRAMES[2][1]),
    )
) + (b"--%b--\r\n" % BOUNDARY)
MEDIA_TYPE = f"multipart/form-data; boundary={BOUNDARY.decode()}"
