"""Names and texts that MAVLink's generators take, for every language that they write."""

import builtins
import keyword
import re

C_WORDS = [
    "auto",
    "break",
    "case",
    "char",
    "const",
    "continue",
    "default",
    "do",
    "double",
    "else",
    "enum",
    "extern",
    "float",
    "for",
    "goto",
    "if",
    "inline",
    "int",
    "long",
    "register",
    "restrict",
    "return",
    "short",
    "signed",
    "sizeof",
    "static",
    "struct",
    "switch",
    "typedef",
    "union",
    "unsigned",
    "void",
    "volatile",
    "while",
    "bool",
    "true",
    "false",
    "class",
    "new",
    "delete",
    "this",
    "throw",
    "try",
    "catch",
    "namespace",
    "template",
    "public",
    "private",
    "protected",
    "virtual",
    "friend",
    "operator",
    "using",
    "function",
    "import",
    "package",
    "export",
    "final",
    "finally",
    "abstract",
    "boolean",
    "byte",
    "interface",
    "native",
    "super",
    "synchronized",
    "transient",
    "let",
    "var",
    "with",
    "yield",
    "await",
    "implements",
    "debugger",
    "instanceof",
    "typeof",
]
GENERATED_WORDS = [
    "system_id",
    "component_id",
    "msg",
    "chan",
    "buf",
    "packet",
    "status",
    "msgbuf",
    "len",
    "self",
    "signing",
    "force_mavlink1",
    "format",
    "name",
    "id",
    "fieldnames",
    "ordered_fieldnames",
    "orders",
    "lengths",
    "array_lengths",
    "crc_extra",
    "unpacker",
    "instance_field",
    "instance_offset",
    "msgname",
    "native_format",
    "fieldtypes",
    "fielddisplays_by_name",
    "fieldenums_by_name",
    "fieldunits_by_name",
]
"""Arguments and attributes of the code that the generators write."""
RESERVED_WORDS = {w.lower() for w in (*C_WORDS, *GENERATED_WORDS, *keyword.kwlist, *dir(builtins))}


def message_name(text: str) -> str:
    """A message's name: capitals, digits and underscores, starting with a letter."""
    return _legal_name(text).upper()


def field_name(path: str) -> str:
    """A field's name from the path of a leaf: what follows `value`, else its last part; dots become underscores."""
    _, _, below = path.partition(".value.")
    return _legal_name(below or path.rsplit(".", 1)[-1])


def unique_name(name: str, taken: set[str]) -> str:
    """The name, numbered where it is taken already (case does not tell two apart); it is taken afterwards.

    taken: names in small letters.
    """
    found, k = name, 1
    while found.lower() in taken:
        k += 1
        found = f"{name}_{k}"
    taken.add(found.lower())
    return found


def plain_text(text: str) -> str:
    """A text of one line that can stand in XML, and in a comment or string of any language: no quotes, no backslash."""
    ascii_only = text.replace("°", "deg").replace("²", "^2").replace("µ", "u").encode("ascii", "replace").decode()
    one_line = " ".join(re.sub("[\0-\x1f\x7f]", " ", ascii_only).split())
    one_line = one_line.replace('"', "'").replace("\\", "/").replace("*/", "* /").replace("'''", "'")
    return one_line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _legal_name(text: str) -> str:
    found = re.sub(r"[^A-Za-z0-9_]", "_", text)
    if not found[:1].isalpha():
        found = f"v_{found.lstrip('_')}"
    return f"{found}_" if found.lower() in RESERVED_WORDS else found
