"""Segmentation and tracking of people in a room that several static cameras see."""
