"""Recordings (LM_direct), envelopes (LM_max), and the solves of what they hold (LM_start)."""
