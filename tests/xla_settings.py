"""XLA's settings for tests.

- Older emitters compile in half the time. JAX up to 0.10 has an option for them.
- XLA compiles each program in up to 32 pieces. A single piece gives the same bits and takes a fifth less CPU time.
- The gate runs most programs for a few milliseconds. Without optimisation, XLA takes a fifth less CPU time in all. The
  other tiers run long programs, which are optimised.
"""

from importlib.metadata import version

OPTION = "xla_cpu_use_fusion_emitters"
HAS_OLDER = tuple(map(int, version("jax").split(".")[:2])) < (0, 11)
OLDER = [f"--{OPTION}=false", "--xla_cpu_parallel_codegen_split_count=1"] if HAS_OLDER else []
UNOPTIMISED = ["--xla_backend_optimization_level=0", "--xla_llvm_disable_expensive_passes=true"]


def choose_flags(optimise: bool) -> str:
    """Value of XLA_FLAGS for the tests. An unknown flag ends the process."""
    return " ".join(OLDER if optimise else [*OLDER, *UNOPTIMISED])


def choose_emitters(newer: bool) -> dict[str, bool]:
    """Compiler's options for one kind or the other; none where there is only the newer one."""
    return {OPTION: newer} if HAS_OLDER else {}
