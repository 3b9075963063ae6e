"""XLA's older emitters, which compile in half the time: JAX has an option for them up to 0.10."""

from importlib.metadata import version

OPTION = "xla_cpu_use_fusion_emitters"
HAS_OLDER = tuple(map(int, version("jax").split(".")[:2])) < (0, 11)


def choose_emitters(newer: bool) -> dict[str, bool]:
    """Compiler's options for one kind or the other; none where there is only the newer one."""
    return {OPTION: newer} if HAS_OLDER else {}
