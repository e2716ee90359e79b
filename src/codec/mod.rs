//! The only caller of file decoders and encoders.
