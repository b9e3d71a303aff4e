"""Decode an XML file by its byte order mark or its declaration, as the XML standard says."""

from __future__ import annotations

import codecs
import re

from climbplan.schema.robots.xml import UrdfFault

# Longer marks first: that of UTF-32 begins with that of UTF-16
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
# How `<` and its neighbour look without a mark
_STARTS = (
    (b"<\0\0\0", "utf-32-le"),
    (b"\0\0\0<", "utf-32-be"),
    (b"<\0", "utf-16-le"),
    (b"\0<", "utf-16-be"),
)
_DECLARED = re.compile(rb"""<\?xml[^>]{0,200}?\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]*)["']""")
# Python has codecs beside these that are no encodings of text files
_KNOWN = re.compile(
    r"utf-?8|(us-)?ascii|(iso[-_]?)?8859-\d+|iso-?8859-\d+|latin-?\d+|(windows-|cp)125\d"
    r"|koi8-[ru]|shift[-_]?jis|euc-(jp|kr)|iso-2022-jp|gb2312|gbk|gb18030|big5"
)
_WIDE = re.compile(r"utf-?(16|32)|ucs-?[24]|iso-10646-ucs-[24]")


def decode_xml(content: bytes) -> str:
    """Return the text of an XML file without its byte order mark.

    UTF-8 where neither a mark nor a declaration says otherwise. Raises UrdfFault for what is not
    text in its encoding, with the line.
    """
    encoding, mark = _identify_encoding(content)
    try:
        text = content[mark:].decode(encoding)
        text.encode()  # halves of surrogates, which some codecs let through
    except LookupError:
        raise UrdfFault(f"declares the encoding {encoding}, expected UTF-8", 1) from None
    except UnicodeDecodeError as error:
        before = content[mark : mark + error.start].decode(encoding, "replace")
        line = before.count("\n") + 1
        raise UrdfFault(f"not {encoding.upper()} text", line) from None
    except UnicodeError:
        raise UrdfFault(f"not {encoding.upper()} text") from None
    return text


def _identify_encoding(content: bytes) -> tuple[str, int]:
    """Return the encoding, and how many bytes its mark takes."""
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return encoding, len(mark)
    for start, encoding in _STARTS:
        if content.startswith(start):
            return encoding, 0
    declaration = _DECLARED.match(content)
    if declaration is None:
        return "utf-8", 0
    encoding_name = declaration[1].decode("ascii").lower()
    if _WIDE.match(encoding_name):  # whoever wrote that, wrote single bytes
        return "utf-8", 0
    if not _KNOWN.fullmatch(encoding_name):
        raise UrdfFault(f"declares the encoding {encoding_name}, expected UTF-8", 1)
    return encoding_name, 0
