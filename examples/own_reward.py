"""A Gymnasium wrapper that charges the fuel that a step burns."""

import gymnasium


class FuelPrice(gymnasium.Wrapper):
    def __init__(self, environment, price=50.0):
        super().__init__(environment)
        self.price = price  # reward for 1 kg of fuel

    def reset(self, **options):
        observation, info = self.env.reset(**options)
        self.used = info["fuel_used"]
        return observation, info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["reward_fuel"] = self.price * (self.used - info["fuel_used"])
        self.used = info["fuel_used"]
        return observation, reward + info["reward_fuel"], terminated, truncated, info
