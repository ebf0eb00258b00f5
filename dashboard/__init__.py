"""The dashboard a quality engineer keeps open: Streamlit pages and Plotly figures on a store that they only read."""
