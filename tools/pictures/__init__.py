"""Pictures of surrogates: what tools/plot_surrogate.py lays out. Needs numpy and matplotlib."""
