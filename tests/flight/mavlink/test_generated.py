"""Signed packets are exchanged with Python and C code made by MAVLink's generator, in both directions."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from flight.mavlink.line import KEY, stamp_at

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.generated import load_python_module, write_c_headers

pytest.importorskip("pymavlink")
pytestmark = pytest.mark.filterwarnings("ignore")  # of the generator's own code
C = r"""
#include <stdio.h>
#include <string.h>
#include <stdlib.h>
#include "trimtab/mavlink.h"
static bool only_signed(const mavlink_status_t *status, uint32_t id) { (void)status; (void)id; return false; }
int main(int argc, char **argv)
{
    mavlink_signing_t signing = {0};
    mavlink_signing_streams_t streams = {0};
    mavlink_status_t *status = mavlink_get_channel_status(0);
    for (int i = 0; i < 32; i++) { unsigned b; sscanf(argv[1] + 2 * i, "%2x", &b); signing.secret_key[i] = b; }
    signing.timestamp = strtoull(argv[2], 0, 10);
    signing.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    signing.accept_unsigned_callback = only_signed;
    status->signing = &signing;
    status->signing_streams = &streams;
    mavlink_message_t m;
    mavlink_status_t s;
    int c, heard = 0;
    while ((c = getchar()) != EOF)
        if (mavlink_parse_char(0, (uint8_t)c, &m, &s) && m.msgid == MAVLINK_MSG_ID_SAMPLE_EVERY) {
            mavlink_sample_every_t got, echo;
            mavlink_msg_sample_every_decode(&m, &got);
            heard++;
            echo = got;
            echo.real = got.real * 2;
            echo.t = got.t + 1;
            echo.vector[2] = -got.vector[2];
            mavlink_msg_sample_every_encode(7, 1, &m, &echo);
            uint8_t out[MAVLINK_MAX_PACKET_LEN];
            fwrite(out, 1, mavlink_msg_to_send_buffer(out, &m), stdout);
        }
    fprintf(stderr, "%d", heard);
    return 0;
}
"""
GIVEN = {"t": 12345678901, "valid": 1, "real": 0.1, "angle": -1e-300, "time": -7, "count": -3, "word": 2**32 - 1}
GIVEN |= {"flag": 1, "vector": (1.5, 2.5, 3.5)}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
def test_signed_frames_round_trip_through_generated_c(dialect, clock, tmp_path):
    folder = write_c_headers(dialect, tmp_path / "include")
    (tmp_path / "echo.c").write_text(C)
    build = ["gcc", "-O1", "-w", f"-I{folder}", str(tmp_path / "echo.c"), "-o", str(tmp_path / "echo")]
    subprocess.run(build, check=True, timeout=120)
    vehicle, stranger = Endpoint(dialect, 1, 1, KEY, clock=clock), Endpoint(dialect, 1, 2, unsigned=True)
    clock.now += 1
    sent = vehicle.pack("SAMPLE_EVERY", GIVEN) + stranger.pack("SAMPLE_EVERY", GIVEN) + b"\xfd garbage"
    sent += vehicle.pack("SAMPLE_EVERY", GIVEN | {"real": 0.25})
    command = [str(tmp_path / "echo"), KEY.secret.hex(), str(stamp_at(clock.now))]
    done = subprocess.run(command, input=sent, capture_output=True, timeout=60, check=True)
    assert done.stderr == b"2"  # the unsigned one is refused there too
    got = vehicle.feed(done.stdout)
    assert [m.get("real") for m in got] == [0.2, 0.5]
    expected = GIVEN | {"t": GIVEN["t"] + 1, "vector": (1.5, 2.5, -3.5), "real": 0.2}
    assert got[0].fields() == expected
    assert got[0].is_signed
    assert vehicle.counts.accepted == 2


def test_every_message_round_trips_through_pymavlink(dialect, clock):
    module = load_python_module(dialect)
    a, b = Endpoint(dialect, 1, 1, KEY, clock=clock), Endpoint(dialect, 2, 1, KEY, clock=clock)
    clock.now += 1
    theirs = module.MAVLink(None, 2, 1)
    theirs.signing.secret_key, theirs.signing.timestamp = KEY.secret, stamp_at(clock.now)
    theirs.signing.sign_outgoing = True
    for name, definition in dialect.definitions.items():
        values = [b"abc" if k == "s" else n % 100 + 1 for n, k in enumerate(_kinds(definition))]
        packed = a.pack(name, values)
        (heard,) = b.feed(packed)
        (message,) = theirs.parse_buffer(packed)
        assert message.get_type() == name
        for field, value in heard.fields().items():
            theirs_value = getattr(message, field)
            assert (tuple(theirs_value) if isinstance(theirs_value, list) else theirs_value) == value, (name, field)
        (back,) = a.feed(bytes(message.pack(theirs)))
        assert back.values == heard.values, name


def _kinds(definition):
    return ["s" if f.type == "char" else "n" for f in definition.fields for _ in range(f.slots)]


def forget(monkeypatch):
    for name in [n for n in sys.modules if n.startswith("trimtab_dialect_")]:
        monkeypatch.delitem(sys.modules, name)


def test_generated_module_is_built_once_by_concurrent_threads(dialect, monkeypatch, tmp_path):
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path))
    forget(monkeypatch)
    with ThreadPoolExecutor(4) as pool:
        first, *others = pool.map(lambda _: load_python_module(dialect), range(4))
    assert dialect.definitions["SAMPLE_EVERY"].id == first.MAVLINK_MSG_ID_SAMPLE_EVERY
    assert all(other is first for other in others)
    assert [str(p) for p in (tmp_path / "dialects").iterdir() if p.suffix == ".py"] == [first.__file__]


@pytest.mark.thorough
def test_two_processes_can_build_the_module_concurrently(tmp_path):
    """Each process finds the complete file or makes it. No temporary file remains."""
    code = "from flight.mavlink.conftest import made; from trimtab.flight.mavlink.generated import load_python_module;"
    code += "print(load_python_module(made()).MAVLINK_MSG_ID_SAMPLE_EVERY)"
    here = os.environ | {"TRIMTAB_CACHE": str(tmp_path), "PYTHONPATH": os.pathsep.join([p for p in sys.path if p])}
    both = [subprocess.Popen([sys.executable, "-c", code], env=here, stdout=subprocess.PIPE) for _ in range(2)]
    said = {p.communicate(timeout=100)[0] for p in both}
    assert len(said) == 1
    assert said.pop().strip().isdigit()
    (file,) = (p for p in (tmp_path / "dialects").iterdir() if p.is_file())
    assert file.suffix == ".py"


def test_module_is_rebuilt_without_a_cache(dialect, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "file"))
    forget(monkeypatch)
    assert dialect.definitions["INSTANT"].id == load_python_module(dialect).MAVLINK_MSG_ID_INSTANT
