"""Conversion of foreign logs (PX4's ULog, ArduPilot's BIN, MCAP, ROS bags, CSV) with a mapping file."""

from trimtab.logs.foreign.read import detect_format, is_own_log, list_topics, read_foreign

__all__ = ["detect_format", "is_own_log", "list_topics", "read_foreign"]
