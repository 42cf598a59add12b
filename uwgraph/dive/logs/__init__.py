"""Logs of messages: what a recording of topics becomes in a dive, by a mapping that people can edit."""
