"""All scenes of a spec by one method, and as rows of datasets."""
