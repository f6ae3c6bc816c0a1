"""PNG pictures by matplotlib, one module per subject.

- `plan`: Route, missed bins and coverage over time of a plan; which bins count.
- `headings`: Coverage of each heading.
- `drives`: Several drives side by side.
- `sensorgraph`: Visibility and residuals of a sensorgraph; `face_pieces` cuts its faces into pieces.
- `identified`: A model of `identify`.
- `design`, `influence`: A designed controller; the influence of factors on a behaviour.
- `localization`: A located run.
- `style`: Common colours, sizes and helpers.

The pictures of a diagnosis are drawn in `sensorgraph.diagnosis.report`.
"""
