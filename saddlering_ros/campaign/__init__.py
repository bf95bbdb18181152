"""Campaigns: every bag under a folder, grouped into sessions of one ring, each given a verdict."""
