"""The change of one ring between two sessions: common errors cancel, differences are diagnosed."""
