"""forestgen: physically based, exactly labelled images of plant communities.

The stages, in order: recipe -> community -> plants -> scene -> render -> labels -> dataset.
`forestgen.pipeline` calls them one after another and reads as a table of contents.
"""

__version__ = "0.1.0"
