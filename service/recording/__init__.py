"""Recordings (LM_direct), envelopes (LM_max), and the solves of their wrenches (LM_start)."""
