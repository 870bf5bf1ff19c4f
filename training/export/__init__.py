"""Trained models as files for a rig: ONNX graphs with their contract, and the signed bundle.

Policies of `training.rl` export themselves and share the graph builder here.
"""
