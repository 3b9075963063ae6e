"""Public logs of other systems: fetch them, read them, and cut the small one that the tests hold.

    python tests/logs/fetch_public_logs.py FOLDER        a .BIN from PyPI; by git, where it can, ULog and rosbag2
    python tests/logs/fetch_public_logs.py FOLDER --cut  and writes tests/logs/data/arducopter.bin anew

| file | from | licence |
|---|---|---|
| 00000081.BIN | source distribution of mavparser 0.0.1 on PyPI | MIT |
| sample_log_small.ulg | github.com/PX4/pyulog, test/ | BSD 3-Clause |
| cdr_test | github.com/ros2/rosbag2, rosbag2_tests/resources/mcap/ | Apache 2.0 |

Only the first is committed, cut. Of the other formats the tests write their files themselves.
"""

import struct
import subprocess
import sys
import tarfile
from pathlib import Path

from trimtab.logs.foreign import list_topics

DATA = Path(__file__).parent / "data" / "arducopter.bin"
PACKAGE, BIN = "mavparser==0.0.1", "mavparser-0.0.1/data/00000081.BIN"
REPOSITORIES = {
    "https://github.com/PX4/pyulog": "test/sample_log_small.ulg",
    "https://github.com/ros2/rosbag2": "rosbag2_tests/resources/mcap/cdr_test",
}
KEPT = ("IMU", "XKF1", "MAG")
"""Types in the cut: what a heading filter reads. Where and who flew is left out."""
BEGIN, END = 12.0, 32.0
"""Seconds into the file: it hovers, then turns by a full circle."""
FMT = 0x80


def fetch_package(folder):
    """The .BIN out of the source distribution, by pip."""
    words = ["--no-deps", "--no-binary", ":all:", "-d", str(folder), PACKAGE]
    subprocess.run([sys.executable, "-m", "pip", "download", "-q", *words], check=True)
    archive = next(folder.glob("mavparser-*.tar.gz"))
    with tarfile.open(archive) as tar:
        tar.extract(BIN, folder, filter="data")
    return folder / BIN


def fetch_repository(folder, address, path):
    """One path of a repository; None without a net."""
    target = folder / address.rpartition("/")[2]
    if not target.exists():
        words = ["git", "clone", "-q", "--depth", "1", address, str(target)]
        if subprocess.run(words, check=False).returncode:
            return None
    return target / path


def cut_bin(data):
    """Definitions and the messages of KEPT from BEGIN to END, byte for byte."""
    lengths, names, kept, at, start = {FMT: 89}, {FMT: "FMT"}, [], 0, None
    definitions = ("FMT", "FMTU", "UNIT", "MULT")
    while at + 3 <= len(data) and data[at : at + 2] == b"\xa3\x95":
        kind = data[at + 2]
        record = data[at : at + lengths[kind]]
        if kind == FMT:
            lengths[record[3]], names[record[3]] = record[4], record[5:9].rstrip(b"\0").decode()
        name = names[kind]
        if name in KEPT:
            (time,) = struct.unpack_from("<Q", record, 3)
            start = time if start is None else start
            if BEGIN <= (time - start) * 1e-6 < END and record[11] == 0:  # the first of its kind
                kept.append(record)
        elif name in definitions and (kind != FMT or names[record[3]] in (*KEPT, *definitions)):
            kept.append(record)
        at += lengths[kind]
    return b"".join(kept)


def main(folder, cut):
    folder.mkdir(parents=True, exist_ok=True)
    found = [fetch_package(folder), *(fetch_repository(folder, *pair) for pair in REPOSITORIES.items())]
    for path in filter(None, found):
        print(path)
        for topic in list_topics(path):
            print(f"  {topic.name}: {topic.rows} rows, {topic.rate:.4g} Hz, {len(topic.fields)} fields")
    if cut:
        DATA.write_bytes(cut_bin(found[0].read_bytes()))
        print(f"wrote {DATA}, {DATA.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]), "--cut" in sys.argv)
