"""Tables for many environments at once, on arrays of JAX or PyTorch.

`jax.evaluator` and `torch.evaluator` make functions of a downloaded table. `evaluator`, `kriging`
and `axes` hold the laws once, for both: they use what the two packages name alike.
"""
