"""A study small enough to be rendered and run within a test."""

TINY = """\
study: tiny
seed: 7
display: {refresh_hz: 240, size_px: [320, 120], width_m: 0.53, distance_m: 0.6}
defaults: {size_px: [48, 32], duration_s: 0.1, warm_up_s: 0, gap_px: 8, iti_s: 0.05}
scenes:
  tunnel: {scene: tunnel_geom, start_s: 1, exposure: 1.0}
conditions:
  plain: {technique: vanilla}
  slow: {technique: vanilla, rate_hz: 60}
  held: {technique: vanilla, rate_hz: 30}
questions:
  which: {kind: choice, text: Which one?}
  rate: {kind: likert, text: The sequence was free of artifacts.}
blocks:
  - {name: welcome, kind: instructions, text: Press a key.}
  - name: pairs
    kind: forced_choice
    compare: {of: [plain, slow, held]}
    factors: {scene: [tunnel]}
    repetitions: 2
    questions: [which]
  - name: ratings
    kind: likert
    factors: {scene: [tunnel], condition: [plain, slow]}
    questions: [rate]
observer:
  utilities: {plain: 2.0, slow: 0.5, held: -2.0}
  rt: {median_s: 0.1, sd_log: 0.3, shift_s: 0.05}
  likert:
    rate: {thresholds: [-2.0, -1.2, -0.4, 0.4, 1.2, 2.2]}
"""
