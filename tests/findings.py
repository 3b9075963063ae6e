"""Run the cases of findings on the present code, beside what happened at first.

    python tests/findings.py compiler           all findings about the compiler
    python tests/findings.py links L15 L16      two of the findings about links

A set is a module of `tests/findings` with a list FINDINGS. The exit status is 0 if all chosen findings hold.
"""

import argparse
import importlib
import sys
import textwrap
from pathlib import Path

WIDTH = 116
"""Width of the printed text."""
FOLDER = Path(__file__).parent / "findings"


def sets() -> list[str]:
    """Return the names of the sets of findings."""
    return sorted(
        file.stem.replace("_", "-") for file in FOLDER.glob("*.py") if file.stem not in ("__init__", "finding")
    )


def paragraph(label: str, text: str) -> str:
    """Return a labelled text of several lines."""
    return textwrap.fill(text, WIDTH, initial_indent=f"    {label:10}", subsequent_indent=" " * 14)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return 1 if a finding does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", choices=sets(), help="area of the findings")
    parser.add_argument("id", nargs="*", help="findings to run; all without")
    given = parser.parse_args(arguments)
    findings = importlib.import_module(f"findings.{given.set.replace('-', '_')}").FINDINGS
    if unknown := [name for name in given.id if name not in [f.id for f in findings]]:
        parser.error(f"no finding {', '.join(unknown)}; choose from {', '.join(f.id for f in findings)}")
    failed = []
    for finding in findings:
        if given.id and finding.id not in given.id:
            continue
        try:
            text, holds = finding.run()
        except Exception as reason:
            text, holds = f"{type(reason).__name__}: {reason}", False
        print(finding.id, "holds" if holds else "DOES NOT HOLD")
        print(
            paragraph("case", finding.case), paragraph("at first", finding.at_first), paragraph("now", text), sep="\n"
        )
        sys.stdout.flush()
        failed += [] if holds else [finding.id]
    print(f"\ndo not hold: {', '.join(failed) or 'none'}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
