"""A run as pictures: a trace replayed in MuJoCo's viewer, or drawn without a screen to mp4, gif or png.

``replay`` reads the trace; ``looks`` says how an arm looks, ``stage`` builds the model that is drawn, ``scene`` poses and
colours it; ``offscreen`` draws, ``caption`` writes on the picture, ``film`` makes the file; ``window`` shows it live.
Nothing here moves an arm: what is drawn is a model of its own, with the robot's kinematics and shapes that weigh nothing.
"""
