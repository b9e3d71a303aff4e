"""The bookshelf: one more book goes among stored ones with the least movement (chapter 8.1).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
