"""Solvers behind `aerotube.sos.solve`, one file each."""
