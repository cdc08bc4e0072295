"""Readers of files that users give. Sizes and shapes are known from headers, and limited, before anything is unpacked;
what cannot be read is an ``InputError`` of one line."""
