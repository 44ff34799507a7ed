"""The verification suite: closed forms, published numbers, invariances, another solver.

Each case is a function in the module of its topic, entered in a list by
`fea.validation.finding.case`; ``python -m wrenchbook.fea.validation`` runs them.
"""
