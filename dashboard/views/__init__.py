"""One module per page; each has `render()`. Not named "pages": Streamlit would run its old navigation on deep links."""
