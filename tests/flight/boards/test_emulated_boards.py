"""Exported autopilots on emulated boards. The sample in sample/ is hand-written, in the shape of an exported folder."""

import ctypes
import subprocess
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.compiler.folder import SampleVectors, write_folder
from trimtab.compiler.workspace import STACK
from trimtab.core.errors import InputError
from trimtab.flight.boards import microcontrollers as microcontroller
from trimtab.flight.boards.microcontrollers import EXACT, TARGETS, emulate, read_vectors

SAMPLE = Path(__file__).parent / "sample"
NAMES = "acceleration,position,heading,fresh,north,east,speed,sigma,mode"
STEPS = 400

needs_board = pytest.mark.usefixtures("board_tools")


def exported(folder, real="double", step=None, **replaced):
    """A folder as trimtab export would write it; expected outputs are zeros until `flown_here` computes them."""
    folder.mkdir()
    for name in ("autopilot.h", "autopilot.c", "vectors.h", "vectors.c"):
        text = (SAMPLE / name).read_text().replace("typedef double", f"typedef {real}")
        for old, new in replaced.items():
            text = text.replace(old, new)
        if name == "autopilot.c" and step is not None:
            text = text[: text.index("#ifdef LIBRARY_SINE")] + step
        (folder / name).write_text(text)
    rng = np.random.default_rng(7)
    heading, fresh = rng.uniform(-3, 3, STEPS), np.arange(STEPS) % 4 == 0
    inputs = np.c_[rng.normal(0, 40, STEPS), rng.normal(0, 0.2, STEPS), heading, fresh]
    inputs[-3:] = [[-0.0, 1e-310, 0, 1], [1e300, np.inf, 1, 1], [0, np.nan, 1, 1]]  # NaN stays in the filter: last
    write(folder, inputs, np.zeros((STEPS, 5)))
    return folder


def write(folder, inputs, outputs):
    rows = np.c_[inputs, outputs]
    np.savetxt(folder / "vectors.csv", rows, fmt="%.17g", delimiter=",", header=NAMES, comments="")


def flown_here(folder):
    """Fly the same C on this computer, put its outputs into vectors.csv, and return them."""
    inputs, library = read_vectors(folder).inputs, folder / "autopilot.so"
    sources = [folder / "autopilot.c", folder / "vectors.c"]
    subprocess.run(["gcc", *EXACT, "-O2", "-shared", "-fPIC", *sources, "-lm", "-o", library], check=True)
    here = ctypes.CDLL(str(library))
    p, s, i, o = (ctypes.create_string_buffer(256) for _ in range(4))
    here.autopilot_defaults(p)
    here.autopilot_init(p, s)
    outputs = np.zeros((len(inputs), 5))
    for row_in, row_out in zip(np.ascontiguousarray(inputs), outputs, strict=True):
        here.vectors_set_in(row_in.ctypes.data_as(ctypes.c_void_p), i)
        here.autopilot_step(p, s, i, o)
        here.vectors_get_out(o, row_out.ctypes.data_as(ctypes.c_void_p))
    write(folder, inputs, outputs)
    return outputs


def same_bits(a, b):
    """True if equal, including signs of zeros. Any NaN equals any NaN, because processors differ in NaN bits."""
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a[a == 0]), np.signbit(b[b == 0]))


@needs_board
@pytest.mark.parametrize(
    ("target", "real"),
    [("cortex-m7", "double"), ("cortex-m4", "float"), ("cortex-m4", "double"), ("cortex-m7", "float")],
)
def test_board_and_computer_agree_bit_by_bit(tmp_path, target, real):
    folder = exported(tmp_path / "sample", real)
    here = flown_here(folder)
    board = emulate(folder, target)
    assert same_bits(board.outputs, here)
    assert same_bits(board.expected_outputs, here)
    assert board.names == ("north", "east", "speed", "sigma", "mode")
    assert set(here[:, 4]) == {0, 1}, "the sample must switch its mode"
    assert np.isnan(here[-1, 0])
    assert not np.isnan(here[:-2]).any()


@needs_board
@pytest.mark.parametrize(("target", "real", "error"), [("cortex-m4", "float", 3e-7), ("cortex-m7", "double", 5e-16)])
def test_library_sines_differ_only_by_rounding(tmp_path, target, real, error):
    """Each library promises about 1 unit in the last place (6e-8, 1.1e-16 relative to 1), but not identical bits."""
    folder = exported(tmp_path / "sample", real, **{"#ifdef LIBRARY_SINE": "#if 1"})
    here, board = flown_here(folder)[:-3], emulate(folder, target)
    assert board.library_bytes > 200, "sine and cosine come from a library"
    there = board.outputs[:-3]
    along = np.hypot(here[:, 0], here[:, 1])[:, None]
    assert np.all(np.abs(there[:, :2] - here[:, :2]) <= error * along)
    assert same_bits(there[:, 2:], here[:, 2:])


def in_assembly(*lines):
    """A step in assembly, so that its number of instructions is known."""
    text = "".join(
        f'"{line}\\n"\n' for line in [".thumb_func", ".type autopilot_step, %function", "autopilot_step:", *lines]
    )
    head = '".syntax unified\\n.section .text.autopilot_step, \\"ax\\"\\n.global autopilot_step\\n"\n'
    return f"__asm({head}{text});\n"


@needs_board
@pytest.mark.parametrize("target", TARGETS)
def test_instructions_and_stack_are_exact(tmp_path, target):
    step = in_assembly(".rept 1234", "nop", ".endr", "sub sp, #4096", "str r0, [sp]", "add sp, #4096", "bx lr")
    board = emulate(exported(tmp_path / "known", step=step), target, steps=20)
    assert board.instructions.tolist() == [1234 + 4] * 20
    assert board.instructions_per_step == (1238, 1238, 1238)
    assert board.stack_bytes == 4096
    assert board.outputs.shape == (20, 5)


@needs_board
def test_input_dependent_instruction_counts_are_exact(tmp_path):
    """autopilot_in starts with the double `acceleration`. Its high word sets the number of loop iterations."""
    step = in_assembly("ldr r0, [r2, #4]", "lsrs r0, #20", "1: subs r0, #1", "bne 1b", "bx lr")
    folder = exported(tmp_path / "known", step=step)
    rounds = np.array([1, 2, 3, 100, 1024, 2047 - 1])
    write(folder, np.c_[np.ldexp(1.0, rounds - 1023), np.zeros((6, 3))], np.zeros((6, 5)))
    board = emulate(folder, "cortex-m7")
    assert board.instructions.tolist() == (3 + 2 * rounds).tolist()
    assert board.instructions_per_step == (5, (3 + 6 + 3 + 200) // 2, 3 + 2 * 2046)


@pytest.mark.thorough
@needs_board
def test_instruction_counts_repeat_and_memory_sizes_match(tmp_path):
    folder = exported(tmp_path / "sample")
    m7, again, m4 = emulate(folder, "cortex-m7"), emulate(folder, "cortex-m7"), emulate(folder, "cortex-m4")
    assert np.array_equal(m7.instructions, again.instructions)
    assert m7.ram_bytes == (2 + 2 + 3) * 8 + (2 + 4 + 1) * 8 + (3 + 1) * 8 + (4 + 1) * 8
    assert 0 < m7.flash_bytes < 2000
    assert m7.library_bytes == 0, "the double FPU needs no library"
    assert m4.library_bytes > 1000, "without one, sums and products of doubles are a library's"
    assert m4.instructions.min() > 20 * m7.instructions.max()
    assert m7.image_bytes > m7.flash_bytes + STEPS * 4 * 8
    assert 0 < m7.stack_bytes < 256


BODY = (
    "void autopilot_step(const autopilot_params *p, autopilot_state *s, const autopilot_in *in, autopilot_out *out) {\n"
)
UNUSED = "(void)p, (void)s, (void)in, (void)out;"


@needs_board
@pytest.mark.parametrize(
    ("statements", "why"),
    [
        ("static int calls; out->mode = ++calls;", "static zeros"),
        ("static int calls = 1; out->mode = ++calls;", "static data"),
        ("extern void *malloc(unsigned); volatile int *at = malloc(8); *at = 1;", "_sbrk"),
        ("int unused;", "unused variable"),
        ("volatile char a[300000]; for (int i = 299999; i >= 0; --i) a[i] = 0; out->mode = a[0];", "took a fault"),
        ("*(volatile int *)0 = 1;", "took a fault"),
        ("out->mode = *(volatile int *)0x1ffffff0;", "took a fault"),
        ("for (;;) __asm volatile(\"\");", "was stopped after 1 s"),
    ],
)  # fmt: skip
def test_rejects_faulty_autopilot_code(tmp_path, statements, why):
    folder = exported(tmp_path / "bad", step=f"{BODY}{UNUSED} {statements} }}\n")
    with pytest.raises(InputError, match=why):
        emulate(folder, "cortex-m7", steps=2, limit_s=1.0)


def test_rejects_mismatched_vectors_file(tmp_path):
    folder = exported(tmp_path / "bad", **{"VECTORS_IN = 4": "VECTORS_IN = 3"})
    with pytest.raises(InputError, match=r"2 steps.* 9 columns; vectors\.h defines 3 inputs and 5 outputs"):
        read_vectors(folder, 2)
    file = folder / "vectors.csv"
    for text, problem in (("", "0 steps"), (f"{NAMES}\n1,2\n", "2 and 9 columns"), (f"{NAMES}\none\n", "'one")):
        file.write_text(text)
        with pytest.raises(InputError, match=problem):
            read_vectors(folder)
    file.unlink()
    with pytest.raises(InputError, match=r"vectors\.csv"):
        read_vectors(folder)


@needs_board
def test_rejects_board_timer_at_wrong_speed(tmp_path, monkeypatch):
    """The calibration loops of known length fail with the wrong clock."""
    folder = exported(tmp_path / "sample")
    monkeypatch.setitem(TARGETS, "cortex-m7", TARGETS["cortex-m7"]._replace(clock=20_000_000))
    with pytest.raises(InputError, match="the board's timer does not run as expected"):
        emulate(folder, "cortex-m7", steps=2)


def test_unknown_target_and_missing_tools_name_the_fix(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="Choices: cortex-m4, cortex-m7"):
        emulate(tmp_path, "cortex-m9")
    monkeypatch.setenv("PATH", str(tmp_path))
    packages = "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
    assert microcontroller.missing_tools() == packages.split()
    with pytest.raises(InputError, match=f"apt-get install {packages}"):
        emulate(tmp_path, "cortex-m7")
    (tmp_path / "arm-none-eabi-gcc").write_text("#!/bin/sh\necho libm.a\n")
    (tmp_path / "arm-none-eabi-gcc").chmod(0o755)
    assert microcontroller.missing_tools() == packages.split()[1:]


@needs_board
def test_large_step_gets_its_workspace_in_ram(tmp_path):
    """The caller provides the workspace of a large program. The workspace counts as RAM."""

    def step(p, s, u):
        x = jnp.cumsum(jnp.sin(jnp.arange(3000.0) * u))[::-1]
        return s + 1.0, jnp.sum(x * jnp.cumsum(x)) + s

    text = block_text(BlockDefinition("autopilot", "A.", step, lambda p: jnp.float64(0.0), (), 0.0))
    assert text.workspace > 0
    here, inputs, outputs = CompiledBlock(text), np.array([[0.1], [-0.7], [2.0]]), np.zeros((3, 1))
    for row_in, row_out in zip(inputs, outputs, strict=True):
        here.inputs[:] = row_in
        here.step()
        row_out[:] = here.outputs
    about = {"scenario": "none", "part": "autopilot", "period_s": 0.01}
    write_folder(tmp_path / "large", text, SampleVectors(inputs, outputs), about, "f64")
    flown = emulate(tmp_path / "large", "cortex-m7")
    np.testing.assert_array_equal(flown.outputs, outputs)
    assert text.workspace < flown.ram_bytes < text.workspace + 1000
    assert flown.stack_bytes < STACK + 1024
