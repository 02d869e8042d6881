@ int16 rows times int8 weights with MVE (Armv8.1-M): three rows by two channels, eight products an instruction.
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

@ The three rows by two channels of half a group.
.macro mtn_half_s4 even, odd
  vldrh.u16 q2, [r5], #16
  vmladava.s16 r0, \even, q2
  vmladava.s16 r2, \odd, q2
  vldrh.u16 q2, [r7], #16
  vmladava.s16 r4, \even, q2
  vmladava.s16 r6, \odd, q2
  vldrh.u16 q2, [r9], #16
  vmladava.s16 r8, \even, q2
  vmladava.s16 r10, \odd, q2
.endm

@ mtn_mve_dot3_s4(shape): the same by 4-bit weights, sixteen in eight bytes. They are stored with 8 added, so sums begin at -8 times
@ those of their rows.
.section .text.mtn_mve_dot3_s4, "ax", %progbits
.p2align 2
.global mtn_mve_dot3_s4
.type mtn_mve_dot3_s4, %function
.thumb_func
mtn_mve_dot3_s4:
  push {r4-r11, lr}
  sub sp, sp, #44
  vpush {d8-d11}
  ldm r0, {r1-r8}
  mov r11, r3
  mov r12, r8
  add r9, r1, r2
  add r10, r9, r2
  lsr r3, r4, #4
  strd r1, r9, [sp, #32]
  strd r10, r3, [sp, #40]
  strd r6, r7, [sp, #48]
  str r5, [sp, #56]
  movs r0, #0
  movs r2, #0
  movs r6, #0
  dlstp.16 lr, r4
1:
  vldrh.u16 q0, [r1], #16
  vaddva.s16 r0, q0
  vldrh.u16 q0, [r9], #16
  vaddva.s16 r2, q0
  vldrh.u16 q0, [r10], #16
  vaddva.s16 r6, q0
  letp lr, 1b
  movs r1, #0
  sub r0, r1, r0, lsl #3
  sub r2, r1, r2, lsl #3
  sub r6, r1, r6, lsl #3
  strd r0, r2, [sp, #60]
  str r6, [sp, #68]
  vmov.i16 q3, #15
2:
  ldrd r5, r7, [sp, #32]
  ldrd r9, lr, [sp, #40]
  mov r1, r11
  add r3, r11, r12
  add r11, r3, r12
  ldrd r0, r4, [sp, #60]
  ldr r8, [sp, #68]
  mov r2, r0
  mov r6, r4
  mov r10, r8
  dls lr, lr
1:
  vldrb.u16 q0, [r1], #8
  vldrb.u16 q1, [r3], #8
  vand q4, q0, q3
  vand q5, q1, q3
  mtn_half_s4 q4, q5
  vshr.u16 q0, q0, #4
  vshr.u16 q1, q1, #4
  mtn_half_s4 q0, q1
  le lr, 1b
  ldrd r1, r3, [sp, #48]
  ldr r5, [sp, #56]
  add r7, r5, r1
  add r9, r7, r1
  strd r4, r6, [r7]
  strd r8, r10, [r9]
  strd r0, r2, [r5], #8
  subs r3, r3, #1
  strd r3, r5, [sp, #52]
  bne 2b
  vpop {d8-d11}
  add sp, sp, #44
  pop {r4-r11, pc}

mtn_mve mtn_mve_dot3, 0
mtn_mve mtn_mve_dot3_transposed, 1

@ mtn_mve_largest(x, count): the largest magnitude, as bits shifted left by one.
.section .text.mtn_mve_largest, "ax", %progbits
.p2align 2
.global mtn_mve_largest
.type mtn_mve_largest, %function
.thumb_func
mtn_mve_largest:
  push {r7, lr}
  movs r2, #0
  wlstp.32 lr, r1, 2f
1:
  vldrw.u32 q0, [r0], #16
  vshl.i32 q0, q0, #1
  vmaxv.u32 r2, q0
  letp lr, 1b
2:
  mov r0, r2
  pop {r7, pc}

@ mtn_mve_round(x, count, factor, q): the integers nearest to x times factor. What is added leaves them in the low half.
.section .text.mtn_mve_round, "ax", %progbits
.p2align 2
.global mtn_mve_round
.type mtn_mve_round, %function
.thumb_func
mtn_mve_round:
  push {r7, lr}
  movw r12, #0
  movt r12, #0x4B40
  wlstp.32 lr, r1, 2f
1:
  vldrw.u32 q0, [r0], #16
  vmul.f32 q0, q0, r2
  vadd.f32 q0, q0, r12
  vstrh.32 q0, [r3], #8
  letp lr, 1b
2:
  pop {r7, pc}

.text
