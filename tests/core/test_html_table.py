"""Tables as a notebook shows them."""

from xml.etree import ElementTree

from trimtab.core.html_table import html_table


def test_html_is_well_formed_and_text_is_escaped():
    text = html_table("a < b", ("x", "y"), [("1", "<script>"), ("2", "&")], "note")
    tree = ElementTree.fromstring(text)
    assert [cell.text for cell in tree.iter("td")] == ["1", "<script>", "2", "&"]
    assert [cell.text for cell in tree.iter("th")] == ["x", "y"]
    assert (tree.find("b").text, tree.find("small").text) == ("a < b", "note")
    assert list(ElementTree.fromstring(html_table("", (), [])).iter("th")) == []
