"""Streamlit pages on the store; reads only."""
