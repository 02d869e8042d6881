@ int16 rows times int8 weights with integer MVE (Armv8.1-M): three rows by two channels, eight products an instruction.
@ Loops are tail-predicated, so any width goes, and rows need no packing.

.syntax unified
.thumb

@ name(shape): x, bytes from row to row of it, weights, terms of a sum, acc, bytes from row to row of it, channel pairs, bytes
@ from row to row of the weights. Terms lie side by side in a row of weights, or (`transposed`) in a column.
.macro mtn_mve name, transposed
.section .text.\name, "ax", %progbits
.p2align 2
.global \name
.type \name, %function
.thumb_func
\name:
  push {r4-r11, lr}
  sub sp, sp, #28
  ldm r0, {r1-r8}
  mov r11, r3
  add r9, r1, r2
  add r10, r9, r2
  strd r1, r9, [sp]
  strd r10, r4, [sp, #8]
  strd r6, r7, [sp, #16]
  str r5, [sp, #24]
  mov r12, r8
  .if \transposed
  movs r0, #0
  vidup.u16 q3, r0, #1
  vmul.i16 q3, q3, r8
  lsl r12, r12, #3
  .endif
2:
  ldrd r5, r7, [sp]
  ldrd r9, lr, [sp, #8]
  mov r1, r11
  .if \transposed
  add r3, r11, #1
  add r11, r11, #2
  .else
  add r3, r11, r12
  add r11, r3, r12
  .endif
  movs r0, #0
  movs r2, #0
  movs r4, #0
  movs r6, #0
  mov r8, r0
  mov r10, r0
  dlstp.16 lr, lr
1:
  .if \transposed
  vldrb.s16 q0, [r1, q3]
  vldrb.s16 q1, [r3, q3]
  add r1, r1, r12
  add r3, r3, r12
  .else
  vldrb.s16 q0, [r1], #8
  vldrb.s16 q1, [r3], #8
  .endif
  vldrh.u16 q2, [r5], #16
  vmladava.s16 r0, q0, q2
  vmladava.s16 r2, q1, q2
  vldrh.u16 q2, [r7], #16
  vmladava.s16 r4, q0, q2
  vmladava.s16 r6, q1, q2
  vldrh.u16 q2, [r9], #16
  vmladava.s16 r8, q0, q2
  vmladava.s16 r10, q1, q2
  letp lr, 1b
  ldrd r1, r3, [sp, #16]
  ldr r5, [sp, #24]
  add r7, r5, r1
  add r9, r7, r1
  strd r4, r6, [r7]
  strd r8, r10, [r9]
  strd r0, r2, [r5], #8
  subs r3, r3, #1
  strd r3, r5, [sp, #20]
  bne 2b
  add sp, sp, #28
  pop {r4-r11, pc}
.endm

mtn_mve mtn_mve_dot3, 0
mtn_mve mtn_mve_dot3_transposed, 1

.text
