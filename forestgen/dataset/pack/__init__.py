"""Data sets as the loaders of training programs want them: WebDataset, Hugging Face."""
