"""Importers of foreign logs: CSV, MAVLink, DataFlash, ROS 2, ULog, raw captures."""
