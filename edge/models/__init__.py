"""Predictors and policies with their contracts: ARX, physics, LSTM and hybrid as ONNX, a trained policy.

A file is believed after it has proved its golden values. The packaged models lie here as well.
"""
