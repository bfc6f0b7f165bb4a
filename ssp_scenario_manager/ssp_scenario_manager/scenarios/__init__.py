"""The kinds of interaction: cut-in, lead braking, crossings; plans of them on a block, predicted
before they are run.
"""
