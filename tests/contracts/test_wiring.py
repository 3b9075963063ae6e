"""Wiring: constructors are short, and no callback is set from outside an object."""

import ast
from collections import defaultdict

from contracts.sources import read_sources, read_statements

CONSTRUCTORS = ("__init__", "__new__", "__post_init__")
MOST_LINES = 30
LONG_CONSTRUCTORS = {"analysis/campaign/campaign.py: Campaign"}
"""Campaign is the interface for users: its fourteen arguments are the options of one command."""
OUTSIDE_CALLBACKS = {
    "commands/end_signals.py: sys.unraisablehook",  # the interpreter's, while a command runs
    "compiler/walk_program.py: w.record",  # the writer of C is the compiler's; what a record does is the program's
    "compiler/native/call.py: made.assemble",  # fields of C structures
    "compiler/native/call.py: made.normalise",
    "logs/ring.py: resource_tracker.register",  # the standard library's, for as long as memory is attached
}


def trees():
    """Path below the package -> tree."""
    return {name: source.tree for name, source in read_sources().items()}


def long_constructors(tree):
    """Classes whose constructor, with its arguments and its docstring, has more than MOST_LINES lines."""
    return [
        c.name
        for c in read_statements(tree)
        if isinstance(c, ast.ClassDef)
        for f in c.body
        if isinstance(f, ast.FunctionDef) and f.name in CONSTRUCTORS and f.end_lineno - f.lineno + 1 > MOST_LINES
    ]


def names_in(expression):
    """Last names of an expression's parts."""
    return {n.attr if isinstance(n, ast.Attribute) else getattr(n, "id", None) for n in ast.walk(expression)}


def callable_attributes(tree):
    """Attributes that a class declares as `Callable`, in its body or on self."""
    found = set()
    for node in read_statements(tree):
        if isinstance(node, ast.AnnAssign) and "Callable" in names_in(node.annotation):
            target = node.target
            if isinstance(target, ast.Attribute):
                found.add(target.attr)
        if isinstance(node, ast.ClassDef):
            fields = [n for n in node.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]
            found |= {n.target.id for n in fields if "Callable" in names_in(n.annotation)}
    return found


def assignments(tree):
    """Pairs of target and value, those of tuples one by one."""
    for node in read_statements(tree):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets if isinstance(node, ast.Assign | ast.AnnAssign) else ():
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                yield from zip(target.elts, node.value.elts, strict=False)
            else:
                for one in target.elts if isinstance(target, ast.Tuple) else [target]:
                    yield one, node.value


def outside_callbacks(tree, declared=frozenset()):
    """Assignments of a function to an attribute of another object. declared: attributes known to be callable."""
    functions = {n.name for n in read_statements(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    properties = {
        n.name
        for n in read_statements(tree)
        if isinstance(n, ast.FunctionDef)
        and any(names_in(d) & {"property", "cached_property"} for d in n.decorator_list)
    }

    def is_function(value):
        name = value.attr if isinstance(value, ast.Attribute) else getattr(value, "id", None)
        return isinstance(value, ast.Lambda) or name in functions - properties

    return [
        ast.unparse(target)
        for target, value in assignments(tree)
        if isinstance(target, ast.Attribute) and getattr(target.value, "id", None) not in ("self", "cls")
        if is_function(value) or target.attr in declared
    ]


def test_no_new_constructor_exceeds_the_line_limit():
    found = {f"{path}: {name}" for path, tree in trees().items() for name in long_constructors(tree)}
    assert found == LONG_CONSTRUCTORS


def test_no_new_callback_is_set_from_outside():
    """An attribute declared as callable counts within its top folder: elsewhere its name means another thing."""
    declared = defaultdict(set)
    for path, tree in trees().items():
        declared[path.partition("/")[0]] |= callable_attributes(tree)
    found = {
        f"{path}: {target}"
        for path, tree in trees().items()
        for target in outside_callbacks(tree, declared[path.partition("/")[0]])
    }
    assert found == OUTSIDE_CALLBACKS


def test_wiring_checks_detect_violations():
    body = "        self.x = 1\n" * MOST_LINES
    assert long_constructors(ast.parse(f"class A:\n    def __init__(self):\n{body}")) == ["A"]
    assert not long_constructors(ast.parse(f"class A:\n    def run(self):\n{body}"))
    outside = """
class A:
    def __init__(self, b):
        self._b, b.tell = b, self._report
        b.far.checks = lambda: ()
        self.own = self._report
        b.number = self._number
        b.known = given
    def _report(self, text): ...
    @property
    def _number(self): ...
"""
    assert outside_callbacks(ast.parse(outside)) == ["b.tell", "b.far.checks"]
    assert outside_callbacks(ast.parse(outside), {"known"}) == ["b.tell", "b.far.checks", "b.known"]
    declared = (
        "class B:\n    known: Callable[[], int]\n    def f(self):\n        self.tell: Callable[[str], None] = print\n"
    )
    assert callable_attributes(ast.parse(declared)) == {"known", "tell"}
