"""The direct solver: nested dissection and a multifrontal Cholesky factorisation."""
