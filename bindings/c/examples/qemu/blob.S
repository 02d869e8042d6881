// The model, on the boundary that the library wants. The include path says which folder it comes from.
    .section .blob, "a"
    .balign 16
    .global model_blob, model_blob_end
model_blob:
    .incbin "nano.blob"
model_blob_end:
    .balign 4
