"""Conversion of logs of other systems with a mapping file: PX4's ULog, ArduPilot's BIN, MCAP, ROS bags and CSV."""

from trimtab.logs.foreign.read import detect_format, is_own_log, list_topics, read_foreign

__all__ = ["detect_format", "is_own_log", "list_topics", "read_foreign"]
