"""Localisation: where, when and by how much a twin disagrees with measured runs, and the inputs involved."""
