"""What every validation group uses: settings, recorder and the cache of finished drives."""
